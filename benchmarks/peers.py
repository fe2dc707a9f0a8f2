"""The paper's linear example as others would run it: one lean closed loop, six solvers of the horizon problem.

A solver is a function ``first_input(A, B, weight, x)`` that gives u_0 of V1. Everything that does not change from step
to step is set up before the loop begins. The rest of the loop (plant, history, window) is the same for all, and calls
LAPACK directly where that is quicker than numpy.
"""

import warnings

import numpy as np
from scipy import sparse
from scipy.linalg import lapack

from rhl.paper.published import linear_example

EXAMPLE = linear_example()
SCHEME, PLANT, STEPS = EXAMPLE.scheme, EXAMPLE.plant, EXAMPLE.steps
N, WINDOW = SCHEME.controller.horizon, SCHEME.estimator.window
n, m = SCHEME.initial_model.n, SCHEME.initial_model.q  # sizes of x(k) and u(k); SISO, so m inputs are m delays
SIZE = n + m - 1  # of Remark 4's augmented state
Q, R, QN = SCHEME.controller.Q, SCHEME.controller.R, SCHEME.controller.QN  # numbers, times the identity
TOLERANCE = 1e-9  # what the iterative solvers are asked for: a hundredth of the tightest of their defaults


def loop(first_input):
    """Run the linear example and return v(k): the window by least squares in square-root form, plant, history."""
    F, G, H = PLANT.F, PLANT.G[:, 0], PLANT.H[0]
    epsilon, z = SCHEME.controller.epsilon, EXAMPLE.z0
    theta = np.hstack([SCHEME.initial_model.A, SCHEME.initial_model.B])
    x, u = np.zeros((WINDOW + 1, n)), np.zeros((WINDOW, m))  # newest first
    A, B = np.eye(SIZE, k=-1), np.eye(SIZE)[:, n : n + 1]
    A[n] = 0
    rows = np.zeros((WINDOW + n + m, n + m + n), order="F")
    v, inputs = 0.0, np.empty(STEPS)
    for k in range(STEPS):
        x[1:], u[1:] = x[:-1], u[:-1]
        x[0, 1:], u[0, 1:] = x[1, :-1], u[1, :-1]
        x[0, 0], u[0, 0] = H @ z, v
        A[:n, :n], A[:n, n:], B[:n, 0] = theta[:, :n], theta[:, n + 1 :], theta[:, n]  # theta~(k-1), as published
        X = np.concatenate([x[0], u[0, :-1]])
        inputs[k] = v = first_input(A, B, (X @ X) / epsilon(k), X)[0]
        # rows = [x' u' | x+ - theta [x u]; I | 0]: the distance from theta~(k-1) stands below the fit.
        rows[:WINDOW, :n], rows[:WINDOW, n : n + m] = x[1:], u
        rows[:WINDOW, n + m :] = x[:-1] - rows[:WINDOW, : n + m] @ theta.T
        rows[WINDOW:, : n + m] = np.eye(n + m)
        rows[WINDOW:, n + m :] = 0
        triangle = lapack.dgeqrf(rows, lwork=1024)[0]
        theta = theta + lapack.dtrtrs(triangle[: n + m, : n + m], triangle[: n + m, n + m :])[0].T
        z = F @ z + G * v
    return inputs


class Sparse:
    """V1 as a quadratic program in z = (u_0, x_1, u_1, ..., x_N), whose pattern never changes.

    ``P``, ``A`` and ``b`` hold z' P z / 2 and A z = b for the latest problem; only their numbers are written.
    """

    def __init__(self):
        stage = 1 + SIZE
        weights = np.tile(np.concatenate([[R], np.full(SIZE, Q)]), N)
        self.P = sparse.diags(weights, format="csc")
        model = np.zeros((SIZE, SIZE + 1), dtype=np.int64)  # where [A B] may be other than zero, numbered
        model[:n] = 1
        model[n, SIZE] = 1
        model[n + 1 :, n:-2] = np.eye(m - 2, dtype=np.int64)
        model[model > 0] = 2 + np.arange(np.count_nonzero(model))
        pattern = np.zeros((N * SIZE, N * stage), dtype=np.int64)
        for i in range(N):
            rows = slice(i * SIZE, (i + 1) * SIZE)
            pattern[rows, i * stage] = model[:, SIZE]
            pattern[rows, i * stage + 1 : (i + 1) * stage] = np.eye(SIZE, dtype=np.int64)
            if i:
                pattern[rows, (i - 1) * stage + 1 : i * stage] = model[:, :SIZE]
        self.A = sparse.csc_matrix(pattern)
        self.numbers, self.where = self.A.data - 1, np.nonzero(model)
        self.A = self.A.astype(np.float64)
        self.b, self.c = np.zeros(N * SIZE), np.zeros(N * stage)

    def write(self, A, B, weight, x):
        """Write the numbers of a problem."""
        model = np.concatenate([A, B], axis=1)[self.where]
        self.A.data[:] = np.concatenate([[1.0], -model])[self.numbers]
        self.P.data[-SIZE:] = weight * QN
        self.b[:SIZE] = A @ x


def clarabel():
    """Clarabel's own interface: one solver, its data updated."""
    import clarabel

    problem, settings = Sparse(), clarabel.DefaultSettings()
    settings.verbose, settings.presolve_enable, settings.max_threads = False, False, 1
    for name in ("tol_feas", "tol_gap_abs", "tol_gap_rel"):
        setattr(settings, name, TOLERANCE)
    cones = [clarabel.ZeroConeT(len(problem.b))]
    solver = clarabel.DefaultSolver(problem.P, problem.c, problem.A, problem.b, cones, settings)

    def first_input(A, B, weight, x):
        problem.write(A, B, weight, x)
        solver.update(P=problem.P.data, A=problem.A.data, b=problem.b)
        return solver.solve().x[:1]

    return first_input


def piqp():
    """PIQP's sparse interface: one solver, its data updated."""
    import piqp

    problem, solver = Sparse(), piqp.SparseSolver()
    for name in ("eps_abs", "eps_rel", "eps_duality_gap_abs", "eps_duality_gap_rel"):
        setattr(solver.settings, name, TOLERANCE)
    solver.setup(problem.P, problem.c, problem.A, problem.b)

    def first_input(A, B, weight, x):
        problem.write(A, B, weight, x)
        solver.update(P=problem.P, A=problem.A, b=problem.b)
        solver.solve()
        return solver.result.x[:1]

    return first_input


def osqp():
    """OSQP, set up once, its data updated."""
    import osqp

    problem, solver = Sparse(), osqp.OSQP()
    accuracy = {"eps_abs": TOLERANCE, "eps_rel": TOLERANCE, "max_iter": 20_000}
    solver.setup(problem.P, problem.c, problem.A, problem.b, problem.b, verbose=False, polishing=True, **accuracy)

    def first_input(A, B, weight, x):
        problem.write(A, B, weight, x)
        solver.update(Px=problem.P.data, Ax=problem.A.data, l=problem.b, u=problem.b)
        return solver.solve(raise_error=False).x[:1]

    return first_input


def quantecon():
    """QuantEcon's LQ, which calls the weight of the state R and that of the input Q."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from quantecon import LQ
    state, control = Q * np.eye(SIZE), R * np.eye(1)

    def first_input(A, B, weight, x):
        problem = LQ(control, state, A, B, T=N, Rf=weight * QN * np.eye(SIZE))
        for _ in range(N):
            problem.update_values()
        return -problem.F @ x

    return first_input


def square_root():
    """The square-root recursion, one LAPACK factorisation a stage."""
    stage = np.zeros((1 + 2 * SIZE, 1 + SIZE), order="F")
    stage[0, 0] = R**0.5
    stage[1 : SIZE + 1, 1:] = Q**0.5 * np.eye(SIZE)
    upper = np.triu(np.ones((SIZE, SIZE)))
    model = np.empty((SIZE, 1 + SIZE))

    def first_input(A, B, weight, x):
        model[:, :1], model[:, 1:] = B, A
        S = (weight * QN) ** 0.5 * np.eye(SIZE)
        for _ in range(N):
            stage[SIZE + 1 :] = S @ model
            triangle = lapack.dgeqrf(stage, lwork=256)[0]
            S = triangle[1 : SIZE + 1, 1:] * upper
        return -(triangle[:1, 1:] @ x) / triangle[0, 0]

    return first_input


def textbook():
    """The textbook recursion P = Q + A'P(A - BK) in compiled loops, for one input; P is made symmetric each stage."""
    import numba

    @numba.njit(error_model="numpy")
    def gain(A, B, P, Q, R):
        size = len(B)
        PB, PA, K, before = np.empty(size), np.empty((size, size)), np.empty(size), np.empty((size, size))
        for _ in range(N):
            r = R
            for i in range(size):
                PB[i] = 0.0
                for j in range(size):
                    PB[i] += P[i, j] * B[j]
                    PA[i, j] = 0.0
                for k in range(size):
                    for j in range(size):
                        PA[i, j] += P[i, k] * A[k, j]
                r += B[i] * PB[i]
            for j in range(size):
                K[j] = 0.0
                for i in range(size):
                    K[j] += PB[i] * A[i, j]
                K[j] /= r
            for i in range(size):
                for j in range(size):
                    PA[i, j] -= PB[i] * K[j]
            for i in range(size):
                for j in range(size):
                    before[i, j] = Q if i == j else 0.0
                for k in range(size):
                    for j in range(size):
                        before[i, j] += A[k, i] * PA[k, j]
            for i in range(size):
                for j in range(size):
                    P[i, j] = (before[i, j] + before[j, i]) / 2
        return K

    def first_input(A, B, weight, x):
        K = gain(np.ascontiguousarray(A), np.ascontiguousarray(B[:, 0]), weight * QN * np.eye(SIZE), Q, R)
        return np.array([-(K @ x)])

    return first_input


PEERS = {
    "numba, P kept symmetric": textbook,
    "numpy and LAPACK, square root": square_root,
    "QuantEcon LQ": quantecon,
    "PIQP": piqp,
    "Clarabel": clarabel,
    "OSQP": osqp,
}
