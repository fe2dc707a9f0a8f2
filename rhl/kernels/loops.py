r"""The compiled loops: rotations, the recursion behind V1, V2 and V3, the estimator's window, the closed loop.

Arrays have their lanes last, ``(rows, columns, lanes)``. A lane is one member of a batch, and every innermost loop runs
over lanes, which a processor can vectorise. With a single lane, inlined bodies see that constant, and the loop
disappears. Functions check nothing and raise nothing.

Everything is in one file, because the compiler's cache is renewed when the file of a function changes, but not when the
file of a called function does.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from rhl._checks import Array
from rhl.kernels._compile import compiled, inlined

# Triangles and rows


@inlined
def _rotate(triangle: Array, rows: Array, columns: int, cosine: Array, sine: Array, lanes: int) -> None:
    height, width = rows.shape[0], triangle.shape[1]
    for j in range(columns):
        for i in range(height):
            for l in range(lanes):
                a = triangle[j, j, l]
                b = rows[i, j, l]
                length = sqrt(a * a + b * b)
                if length > 0.0:
                    cosine[l] = a / length
                    sine[l] = b / length
                else:
                    cosine[l] = 1.0
                    sine[l] = 0.0
                triangle[j, j, l] = length
            for k in range(j + 1, width):
                for l in range(lanes):
                    above = triangle[j, k, l]
                    below = rows[i, k, l]
                    triangle[j, k, l] = cosine[l] * above + sine[l] * below
                    rows[i, k, l] = cosine[l] * below - sine[l] * above


@compiled
def rotate(triangle: Array, rows: Array, columns: int) -> None:
    """Rotate rows into an upper triangle: M'M of M = [triangle; rows] is unchanged, ``columns`` of rows become zero.

    Rotations keep the relative accuracy of a small row next to a large one in any order; reflections do so only if rows
    are sorted by size.
    """
    lanes = triangle.shape[2]
    cosine, sine = np.empty(lanes), np.empty(lanes)
    if lanes == 1:
        _rotate(triangle, rows, columns, cosine, sine, 1)
    else:
        _rotate(triangle, rows, columns, cosine, sine, lanes)


@inlined
def _multiply(S: Array, M: Array, product: Array, lanes: int) -> None:
    for i in range(S.shape[0]):
        for j in range(M.shape[1]):
            for l in range(lanes):
                product[i, j, l] = 0.0
            for k in range(i, S.shape[0]):
                for l in range(lanes):
                    product[i, j, l] += S[i, k, l] * M[k, j, l]


@compiled
def multiply(S: Array, M: Array, product: Array) -> None:
    """Multiply an upper triangle S by M."""
    if S.shape[2] == 1:
        _multiply(S, M, product, 1)
    else:
        _multiply(S, M, product, S.shape[2])


@compiled
def back_substitute(triangle: Array, columns: int) -> None:
    """Solve with the triangle in the first ``columns`` for the remaining columns, in place."""
    lanes = triangle.shape[2]
    for i in range(columns - 1, -1, -1):
        for j in range(columns, triangle.shape[1]):
            for k in range(i + 1, columns):
                for l in range(lanes):
                    triangle[i, j, l] -= triangle[i, k, l] * triangle[k, j, l]
            for l in range(lanes):
                triangle[i, j, l] /= triangle[i, i, l]


@compiled
def put(
    M: Array, row: int, column: int, source: Array, first_row: int, first_column: int, shape: tuple[int, int]
) -> None:
    """Copy a block of that shape from ``source`` into M."""
    for i in range(shape[0]):
        for j in range(shape[1]):
            for l in range(M.shape[2]):
                M[row + i, column + j, l] = source[first_row + i, first_column + j, l]


# The recursion: |S' x|^2 is the least of |Q^(1/2) x|^2 + |R^(1/2) u|^2 + |S (A x + B u)|^2 over u


@compiled
def stage(S: Array, M: Array, Q: Array, R: Array, before: Array, K: Array, V: Array) -> None:
    """Step one stage back: ``before`` is S', u = -K x the minimiser, |V (u + K x)|^2 the extra cost of another u.

    S is upper triangular, (n', n', lanes); M = [B A] is (n', q + n, lanes); Q and R are upper factors, Q of the first
    entries of the state.
    """
    q, c, size, lanes = R.shape[0], Q.shape[0], M.shape[1], M.shape[2]
    triangle, rows = np.zeros((size, size, lanes)), np.empty(M.shape)
    multiply(S, M, rows)
    put(triangle, 0, 0, R, 0, 0, (q, q))
    put(triangle, q, q, Q, 0, 0, (c, c))
    rotate(triangle, rows, size)
    put(before, 0, 0, triangle, q, q, (size - q, size - q))
    put(V, 0, 0, triangle, 0, 0, (q, q))
    back_substitute(triangle, q)
    put(K, 0, 0, triangle, 0, q, (q, size - q))


@compiled
def recursion(S: Array, M: Array, Q: Array, R: Array, K: Array, V: Array) -> None:
    """Step N stages back, writing K, (N, q, n, lanes), and V, (N, q, q, lanes); S becomes the initial one."""
    for i in range(K.shape[0] - 1, -1, -1):
        stage(S, M, Q, R, S, K[i], V[i])


@compiled
def rollout(M: Array, K: Array, x: Array, u: Array) -> None:
    """Predict x, (N + 1, n, lanes), from x_0 with M = [B A]; u, (N, q, lanes), first holds increments on -K x."""
    q, n, lanes = u.shape[1], x.shape[1], x.shape[2]
    for i in range(u.shape[0]):
        for a in range(q):
            for b in range(n):
                for l in range(lanes):
                    u[i, a, l] -= K[i, a, b, l] * x[i, b, l]
        for a in range(n):
            for l in range(lanes):
                x[i + 1, a, l] = 0.0
            for b in range(n):
                for l in range(lanes):
                    x[i + 1, a, l] += M[a, q + b, l] * x[i, b, l]
            for b in range(q):
                for l in range(lanes):
                    x[i + 1, a, l] += M[a, b, l] * u[i, b, l]


# The scheme


@compiled
def fit(x: Array, u: Array, centre: Array, trust: Array, hold: Array, fitted: Array) -> None:
    """Solve equation (15) for squares: the rows of theta = [A B] by least squares, held near those of the centre.

    x is (window + 1, n, lanes) and u (window, m, lanes), newest first; ``centre`` and ``fitted`` are (n, n + m, lanes).
    ``trust``, (groups, window), and ``hold``, (groups, n + m), are roots of weights; there is one group for all rows
    of theta, or one per row.
    """
    window, n, d, lanes = u.shape[0], x.shape[1], x.shape[1] + u.shape[1], x.shape[2]
    count = n if trust.shape[0] == 1 else 1
    rows = np.empty((window, d + count, lanes))
    for group in range(trust.shape[0]):
        triangle = np.zeros((d, d + count, lanes))
        for i in range(d):
            for l in range(lanes):
                triangle[i, i, l] = hold[group, i]
        for j in range(window):
            put(rows, j, 0, x, j + 1, 0, (1, n))
            put(rows, j, n, u, j, 0, (1, d - n))
            for t in range(count):
                for l in range(lanes):
                    rows[j, d + t, l] = x[j, group + t, l]
                for i in range(d):
                    for l in range(lanes):
                        rows[j, d + t, l] -= centre[group + t, i, l] * rows[j, i, l]
            for i in range(d + count):
                for l in range(lanes):
                    rows[j, i, l] *= trust[group, j]
        rotate(triangle, rows, d)
        back_substitute(triangle, d)
        for t in range(count):
            for i in range(d):
                for l in range(lanes):
                    fitted[group + t, i, l] = centre[group + t, i, l] + triangle[i, d + t, l]


@compiled
def newton_step(R: Array, root: Array, target: Array, straight: Array, hold: Array, back: Array, found: Array) -> None:
    """Solve (hold^2 + R' root^2 R) found = hold back + R' (root target + straight), lane by lane, by rotations.

    R is (m, d) for all lanes; ``root``, ``target`` and ``straight`` are (m, lanes), ``hold``, ``back`` and ``found``
    (d, lanes); root and hold stand for diagonal matrices.
    """
    m, d, lanes = R.shape[0], R.shape[1], root.shape[1]
    triangle, rows, pull = np.zeros((d, d + 1, lanes)), np.empty((m, d + 1, lanes)), np.empty((d, lanes))
    for i in range(d):
        for l in range(lanes):
            triangle[i, i, l] = hold[i, l]
            triangle[i, d, l] = back[i, l]
    for j in range(m):
        for i in range(d):
            for l in range(lanes):
                rows[j, i, l] = root[j, l] * R[j, i]
        for l in range(lanes):
            rows[j, d, l] = target[j, l]
    rotate(triangle, rows, d)
    for i in range(d):
        for l in range(lanes):
            pull[i, l] = 0.0
        for j in range(m):
            for l in range(lanes):
                pull[i, l] += R[j, i] * straight[j, l]
        for k in range(i):
            for l in range(lanes):
                pull[i, l] -= triangle[k, i, l] * pull[k, l]
        for l in range(lanes):
            pull[i, l] /= triangle[i, i, l]
            triangle[i, d, l] += pull[i, l]
    back_substitute(triangle, d)
    for i in range(d):
        for l in range(lanes):
            found[i, l] = triangle[i, d, l]


@inlined
def augment(theta: Array, M: Array, q: int) -> None:
    """Write Remark 4's pair of theta = [A B], (n, n + m, lanes), into M = [B A], (n', q + n', lanes), which is zero."""
    n, past = theta.shape[0], M.shape[0] - theta.shape[0]
    put(M, 0, 0, theta, 0, n, (n, q))
    put(M, 0, q, theta, 0, 0, (n, n))
    put(M, 0, q + n, theta, 0, n + q, (n, past))
    for l in range(theta.shape[2]):
        for i in range(min(q, past)):
            M[n + i, i, l] = 1.0
        for i in range(past - q):
            M[n + q + i, q + n + i, l] = 1.0


@inlined
def first_input(M: Array, Q: Array, R: Array, QN: Array, horizon: int, weight: Array, x: Array, v: Array) -> None:
    """Write the first input of V1's solution from x, (n, lanes), into v, (q, lanes); Q, R, QN are upper factors."""
    q, n, lanes = R.shape[0], M.shape[0], M.shape[2]
    S, stage_Q, stage_R = np.zeros(QN.shape), np.zeros(Q.shape), np.zeros(R.shape)
    for l in range(lanes):
        # Divided by a weight above one, no square leaves the range of floating-point numbers.
        up, down = sqrt(min(weight[l], 1.0)), sqrt(max(weight[l], 1.0))
        for i in range(n):
            for j in range(i, n):
                S[i, j, l] = QN[i, j, l] * up
                stage_Q[i, j, l] = Q[i, j, l] / down
        for i in range(q):
            for j in range(i, q):
                stage_R[i, j, l] = R[i, j, l] / down
    K, V = np.empty((horizon, q, n, lanes)), np.empty((horizon, q, q, lanes))
    recursion(S, M, stage_Q, stage_R, K, V)
    for a in range(q):
        for l in range(lanes):
            v[a, l] = 0.0
        for b in range(n):
            for l in range(lanes):
                v[a, l] -= K[0, a, b, l] * x[b, l]


@inlined
def apply(M: Array, x: Array, start: Array) -> None:
    """Write M x into ``start``, (rows, lanes)."""
    for a in range(M.shape[0]):
        for l in range(M.shape[2]):
            start[a, l] = 0.0
        for b in range(M.shape[1]):
            for l in range(M.shape[2]):
                start[a, l] += M[a, b, l] * x[b, l]


@inlined
def push(history: Array, newest: Array) -> None:
    """Shift a stacked history by one step: the newest entries come first, in the row and as the first row."""
    size, new = history.shape[1], newest.shape[0]
    for l in range(history.shape[2]):
        for i in range(history.shape[0] - 1, 0, -1):
            for a in range(size):
                history[i, a, l] = history[i - 1, a, l]
        for a in range(size - 1, new - 1, -1):
            history[0, a, l] = history[0, a - new, l]
        for a in range(new):
            history[0, a, l] = newest[a, l]


@compiled
def clear(M: Array, lane: int) -> None:
    """Set one lane to zero."""
    for i in range(M.shape[0]):
        for j in range(M.shape[1]):
            M[i, j, lane] = 0.0


@inlined
def control(
    x: Array, u: Array, theta: Array, estimator: tuple, controller: tuple, epsilon: float, v: Array, estimate: Array
) -> None:
    """Take one step from the lifted signals x(k), ... and u(k-1), ...: theta becomes theta~(k), v is the input.

    estimator: trust, hold, lambda. controller: Q, R, QN, horizon, alpha, and whether to use theta~(k-1).
    """
    trust, hold, lam = estimator
    Q, R, QN, horizon, alpha, delay = controller
    n, q, size, lanes = theta.shape[0], R.shape[0], Q.shape[0], theta.shape[2]
    M, X, weight = np.zeros((size, q + size, lanes)), np.empty((size, lanes)), np.zeros(lanes)
    if delay:
        augment(theta, M, q)
    fit(x, u, theta, trust, hold, estimate)
    for a in range(n):
        for b in range(theta.shape[1]):
            for l in range(lanes):
                theta[a, b, l] = (1.0 - lam) * estimate[a, b, l] + lam * theta[a, b, l]
    if not delay:
        augment(theta, M, q)
    for a in range(size):
        for l in range(lanes):
            X[a, l] = x[0, a, l] if a < n else u[0, a - n, l]
            weight[l] += X[a, l] * X[a, l]
    for l in range(lanes):
        weight[l] = alpha * weight[l] / epsilon
    first_input(M, Q, R, QN, horizon, weight, X, v)


@compiled
def run(
    first: int,
    plant: tuple,
    z: Array,
    lifted: Array,
    state: tuple,
    estimator: tuple,
    controller: tuple,
    epsilon: Array,
    diverged: Array,
    signals: tuple,
    models: tuple,
) -> None:
    """Run the loop for as many steps as there are values of epsilon.

    plant: [F G] and [H 0], which act on ``z``, the stacked state and input. Without rows the plant is the caller's, and
    ``lifted``, (steps, n, lanes), holds x(k).
    state: x, u, v(k-1) and theta~(k-1). estimator, controller: see ``control``. signals: outputs for y, v, z,
    (steps, size, lanes). models: outputs for theta* and theta~, unused without rows. ``first`` is the k of the
    first step. ``diverged``, (lanes,), is -1 until a lane leaves the range of floating-point numbers, then the k at
    which it did; its plant keeps its last state.
    """
    FG, H = plant
    x, u, v, theta = state
    y_out, v_out, z_out = signals
    estimates, kept = models
    size, n, m, lanes = FG.shape[0], theta.shape[0], theta.shape[1], theta.shape[2]
    estimate, y, moved = np.empty_like(theta), np.empty((H.shape[0], lanes)), np.empty((size, lanes))
    gap = np.empty(lanes)
    for j in range(epsilon.shape[0]):
        push(u, v)
        if size > 0:
            apply(H, z, y)
            push(x, y)
            for l in range(lanes):
                for a in range(y.shape[0]):
                    y_out[j, a, l] = y[a, l]
                for a in range(size):
                    z_out[j, a, l] = z[a, l]
        else:
            push(x, lifted[j])
        control(x, u, theta, estimator, controller, epsilon[j], v, estimate)
        # The difference of a number with itself is zero if it is finite, and NaN otherwise.
        for l in range(lanes):
            gap[l] = 0.0
            for a in range(v.shape[0]):
                v_out[j, a, l] = v[a, l]
                gap[l] += v[a, l] - v[a, l]
            for a in range(n):
                gap[l] += x[0, a, l] - x[0, a, l]
                for b in range(m):
                    gap[l] += theta[a, b, l] - theta[a, b, l]
        if kept.shape[0] > 0:
            put(estimates[j], 0, 0, estimate, 0, 0, (n, m))
            put(kept[j], 0, 0, theta, 0, 0, (n, m))
        for l in range(lanes):
            if gap[l] != 0.0:
                if diverged[l] < 0:
                    diverged[l] = first + j
                clear(x, l)
                clear(u, l)
                clear(theta, l)
                for a in range(v.shape[0]):
                    v[a, l] = 0.0
        if size > 0:
            for a in range(v.shape[0]):
                for l in range(lanes):
                    z[size + a, l] = v[a, l]
            apply(FG, z, moved)
            for l in range(lanes):
                gap[l] = 0.0
                for a in range(size):
                    gap[l] += moved[a, l] - moved[a, l]
                if gap[l] != 0.0 and diverged[l] < 0:
                    diverged[l] = first + j + 1
                if diverged[l] < 0:
                    for a in range(size):
                        z[a, l] = moved[a, l]
