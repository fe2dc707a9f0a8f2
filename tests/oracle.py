"""Oracles in extended precision: other algorithms than the library's, on numpy object arrays of mpmath numbers.

Digits are plentiful here, so each oracle takes the shortest way: the textbook Riccati recursion and the condensed
normal equations, which are no good in float64. Every datum is taken over exactly as float64 holds it.
"""

from collections.abc import Callable, Mapping

import mpmath
import numpy as np

# The worst condition number in these tests is about 1e40; 80 digits leave 40.
mpmath.mp.dps = 80
EXACT_ZERO = mpmath.mpf(10) ** -40  # against data of order one: what cancels exactly leaves less, nothing else does
HALF_ULP = 2.0**-53

exact = np.frompyfunc(mpmath.mpf, 1, 1)


def rounded(array: np.ndarray) -> np.ndarray:
    """Return the nearest float64."""
    return np.asarray(array).astype(np.float64)


def solve(A: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Solve A x = b for as many columns as b has, by elimination with partial pivoting."""
    n = len(A)
    work = np.concatenate([A, b.reshape(n, -1)], axis=1)
    for i in range(n):
        pivot = i + int(np.argmax(np.abs(work[i:, i])))
        work[[i, pivot]] = work[[pivot, i]]
        work[i + 1 :, i:] -= np.outer(work[i + 1 :, i] / work[i, i], work[i, i:])
    for i in reversed(range(n)):
        work[i, n:] = (work[i, n:] - work[i, i + 1 : n] @ work[i + 1 :, n:]) / work[i, i]
    return work[:, n:].reshape(b.shape)


def independent_rows(G: np.ndarray, h: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Reduce the consistent equations G u = h to as many as G has rank, by elimination with full pivoting."""
    work = np.concatenate([G, h[:, None]], axis=1)
    rank = 0
    while rank < min(G.shape):
        remaining = np.abs(work[rank:, :-1])
        row, column = np.unravel_index(np.argmax(remaining), remaining.shape)
        if remaining[row, column] < EXACT_ZERO:
            break
        work[[rank, rank + row]] = work[[rank + row, rank]]
        work[rank] = work[rank] / work[rank, column]
        others = np.arange(len(work)) != rank
        work[others] -= np.outer(work[others, column], work[rank])
        rank += 1
    return work[:rank, :-1], work[:rank, -1]


def riccati(A, B, Q, R, QN, weight, horizon: int, x) -> np.ndarray:
    """Return u_0 of V1 by the textbook recursion P = Q + A'PA - A'PB (R + B'PB)^-1 B'PA."""
    A, B, Q, R, P, x = map(exact, (A, B, Q, R, QN, x))
    P = P * exact(float(weight))
    for _ in range(horizon):
        PB = P @ B
        K = solve(R + B.T @ PB, PB.T @ A)
        P = Q + A.T @ (P @ (A - B @ K))
        P = (P + P.T) / 2
    return -(K @ x)


def first_input(problem, x) -> np.ndarray:
    """Return u_0 of a problem V1 from the augmented state x, by the same recursion."""
    model = problem.model
    return riccati(model.A, model.B, problem.Q, problem.R, problem.QN, problem.weight, problem.horizon, x)


def powers(A, B, horizon: int) -> tuple[np.ndarray, np.ndarray]:
    """Return A_0 .. A_N and B_0 .. B_{N-1} of equation (21)."""
    A, B = exact(A), exact(B)
    maps = [exact(np.eye(len(A)))]
    for _ in range(horizon):
        maps.append(A @ maps[-1])
    return np.stack(maps), np.stack([M @ B for M in maps[:-1]])


def condensed(maps_A, maps_B, x) -> tuple[np.ndarray, np.ndarray]:
    """Return f and M with [x_0; ...; x_N] = f + M [u_0; ...; u_{N-1}], equation (5)."""
    maps_A, maps_B, x = exact(maps_A), exact(maps_B), exact(x)
    N, n, q = maps_B.shape
    M = np.full(((N + 1) * n, N * q), mpmath.mpf(0))
    for i in range(1, N + 1):
        for j in range(i):
            M[i * n : (i + 1) * n, j * q : (j + 1) * q] = maps_B[i - 1 - j]
    return (maps_A @ x).reshape(-1), M


def _weigh(Q, M: np.ndarray) -> np.ndarray:
    """Multiply every stage's rows of M by Q."""
    return (exact(Q) @ M.reshape(-1, len(Q), M.shape[1])).reshape(M.shape)


def v1(maps_A, maps_B, Q, R, QN, weight, x) -> np.ndarray:
    """Return all inputs of V1, shape (N, q), by the condensed normal equations."""
    N, n, q = maps_B.shape
    f, M = condensed(maps_A, maps_B, x)
    weighed = np.concatenate([_weigh(Q, M[:-n]), exact(QN) * exact(float(weight)) @ M[-n:]])
    return -solve(M.T @ weighed + exact(np.kron(np.eye(N), R)), weighed.T @ f).reshape(N, q)


def _equality(maps_A, maps_B, Q, R, x, G: np.ndarray, h: np.ndarray) -> np.ndarray:
    """Minimise the sum of the stages under G u = h, by the saddle-point equations."""
    N, n, q = maps_B.shape
    f, M = condensed(maps_A, maps_B, x)
    weighed = _weigh(Q, M[:-n])
    G, h = independent_rows(G, h)
    saddle = np.full((N * q + len(G),) * 2, mpmath.mpf(0))
    saddle[: N * q, : N * q] = M[:-n].T @ weighed + exact(np.kron(np.eye(N), R))
    saddle[N * q :, : N * q] = G
    saddle[: N * q, N * q :] = G.T
    return solve(saddle, np.concatenate([-(weighed.T @ f[:-n]), h]))[: N * q].reshape(N, q)


def v2(maps_A, maps_B, QN, x) -> np.ndarray:
    """Return V2's inputs of least norm, shape (N, q): the minimisers are the solutions of M'QN (M u + f) = 0."""
    n, q = maps_B.shape[1:]
    f, M = condensed(maps_A, maps_B, x)
    weighed = exact(QN) @ M[-n:]
    return _equality(maps_A, maps_B, np.eye(n), np.eye(q), x, M[-n:].T @ weighed, -(weighed.T @ f[-n:]))


def v3(maps_A, maps_B, Q, R, r, x) -> np.ndarray:
    """Return V3's inputs, shape (N, q); r must be reachable exactly."""
    n = maps_B.shape[1]
    f, M = condensed(maps_A, maps_B, x)
    return _equality(maps_A, maps_B, Q, R, x, M[-n:], exact(r) - f[-n:])


def relative_error(found: np.ndarray, true: np.ndarray) -> float:
    """Return |found - true| / |true| in the Euclidean norm."""
    gap, size = exact(found) - true, np.sum(true**2)
    return float(mpmath.sqrt(np.sum(gap**2) / size)) if size else float(mpmath.sqrt(np.sum(gap**2)))


def movement(
    answer: Callable[..., np.ndarray], data: Mapping[str, np.ndarray], rng: np.random.Generator, draws: int
) -> float:
    """Return how far rounding the data moves the answer: the most of some draws of half an ulp on every entry."""
    true = answer(**data)

    def shaken() -> dict[str, np.ndarray]:
        signs = {name: rng.choice([-HALF_ULP, HALF_ULP], np.shape(value)) for name, value in data.items()}
        symmetric = {name: (s + s.T) / 2 if name in ("Q", "R", "QN") else s for name, s in signs.items()}
        return {name: exact(value) * (1 + exact(symmetric[name])) for name, value in data.items()}

    return max(relative_error(answer(**shaken()), true) for _ in range(draws))
