"""Data and estimates for the claims about Theorem 2: windows, residuals, prediction errors and their bounds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rhl._checks import Array
from rhl.estimator import ProximalEstimator
from rhl.losses import Convex, Varying, WeightedSquares
from rhl.model import SignalModel


def theta_matrix(model: SignalModel) -> Array:
    """Return [A B], shape (n, n+q)."""
    return np.concatenate([model.A, model.B], axis=-1)


def stacked_signals(x: Array) -> Array:
    """Return s(k) of (16) for x = x(k), x(k-1), ..., x(k-window), shape (window * n,)."""
    return x[:-1].reshape(-1)


def regressor_matrix(x: Array, u: Array) -> Array:
    """Return R(k) of (17), with its Kronecker products written out, shape (window * n, n(n+q)).

    ``x`` (window + 1, n): x(k), ..., x(k-window).
    ``u`` (window, q): u(k-1), ..., u(k-window).
    """
    eye = np.eye(x.shape[1])
    return np.vstack([np.hstack([np.kron(a[None], eye), np.kron(b[None], eye)]) for a, b in zip(x[1:], u, strict=True)])


@dataclass(frozen=True, eq=False)
class Estimates:
    """The estimates (15) for recorded signals.

    ``x`` (K+1, n): x(0), ..., x(K); zero before. ``u`` (K, q): u(0), ..., u(K-1); zero before.
    ``window``: the paper's N bar. ``best``: theta*(1), ..., theta*(K); entry k - 1 belongs to k.
    ``models``: theta~(0), ..., theta~(K). ``mixing`` (K,): lambda_1, ..., lambda_K; zero by default.
    """

    x: Array
    u: Array
    window: int
    best: Sequence[SignalModel]
    models: Sequence[SignalModel]
    mixing: Array | None = None

    def data(self, k: int) -> tuple[Array, Array]:
        """Return x(k), ..., x(k-window) and u(k-1), ..., u(k-window)."""
        past = np.arange(k, k - self.window - 1, -1)
        x = np.where((past >= 0)[:, None], self.x[np.maximum(past, 0)], 0.0)
        u = np.where((past[1:] >= 0)[:, None], self.u[np.maximum(past[1:], 0)], 0.0)
        return x, u

    def residuals(self, k: int, model: SignalModel) -> Array:
        """Return x(j) - A x(j-1) - B u(j-1) for j = k, ..., k-window+1, shape (window, n)."""
        x, u = self.data(k)
        return x[:-1] - x[1:] @ model.A.T - u @ model.B.T

    def moves(self) -> Array:
        """Return the norms of theta*(k) - theta~(k-1), shape (K,)."""
        pairs = zip(self.best, self.models[:-1], strict=True)
        return np.array([np.linalg.norm(new.theta - old.theta) for new, old in pairs])

    def misfits(self) -> Array:
        """Return the size of e*(k), the residuals of theta*(k) over the window, shape (K,)."""
        return np.array([np.linalg.norm(self.residuals(k + 1, model)) for k, model in enumerate(self.best)])

    def distances(self, theta: Array) -> Array:
        """Return the norms of theta - theta~(k), shape (K+1,)."""
        return np.array([np.linalg.norm(theta - model.theta) for model in self.models])


def estimate(
    x: Array,
    u: Array,
    initial: SignalModel,
    window: int,
    mixing: Array,
    first: int = 1,
    loss: Convex | Varying | None = None,
) -> Estimates:
    """Run the estimator (15) on recorded x, shape (K+1, n), and u, shape (K, q).

    ``initial``: theta~(0). ``mixing`` (K,): lambda_1, ..., lambda_K. ``loss``: c; squares by default.
    ``first``: the first k at which the estimate may change; ``window`` excludes the zeros before k = 0.
    """
    estimator = ProximalEstimator(window, loss=WeightedSquares() if loss is None else loss)
    best: list[SignalModel] = []
    models = [initial]
    record = Estimates(x, u, window, best, models, mixing)
    for k, lam in enumerate(mixing, start=1):
        best.append(estimator.minimise(models[-1], *record.data(k), k) if k >= first else models[-1])
        models.append(best[-1].mix(models[-1], lam))
    return record


def trajectory(model: SignalModel, x0: Array, u: Array) -> Array:
    """Return x(0), ..., x(K) of (18) for given inputs, shape (K+1, n)."""
    x = [np.asarray(x0, dtype=np.float64)]
    for now in u:
        x.append(model.step(x[-1], now))
    return np.array(x)


def draw_model(rng: np.random.Generator, n: int, q: int, radius: float = 0.9) -> SignalModel:
    """Draw a signal model whose A has the given spectral radius."""
    A = rng.standard_normal((n, n))
    return SignalModel(A * radius / max(abs(np.linalg.eigvals(A))), rng.standard_normal((n, q)))


def spiral_estimates(steps: int, window: int = 1, exponent: float = 0.75) -> Estimates:
    r"""Run the estimator on data of :math:`A = 0,\ B = 0`, with inputs nearly orthogonal to its own estimate of B.

    The signal is a number that stays zero, the inputs are unit vectors :math:`d_k` of the plane with
    :math:`\tilde B(k-1) d_k = \delta_k |\tilde B(k-1)|`, :math:`\delta_k = k^{-e}/2`. Assumption 7 holds.
    ``exponent``: e; above one the angles have a finite sum.
    """
    estimator = ProximalEstimator(window)
    models, u = [SignalModel(np.zeros((1, 1)), np.array([[1.0, 0.0]]))], np.zeros((steps, 2))
    record = Estimates(np.zeros((steps + 1, 1)), u, window, models[1:], models)
    for k in range(1, steps + 1):
        b = models[-1].B[0] / np.hypot(*models[-1].B[0])
        delta = 0.5 * k**-exponent
        u[k - 1] = delta * b + np.sqrt(1 - delta**2) * np.array([b[1], -b[0]])
        models.append(estimator.minimise(models[-1], *record.data(k)))
    return Estimates(record.x, u, window, models[1:], models)


def prediction_errors(record: Estimates, k: int, inputs: Array, truth: SignalModel) -> Array:
    """Return e_1(k), ..., e_N(k) of (8) for the powers (21) of theta~(k): prediction minus truth, shape (N, n).

    ``inputs`` (N, q): the s_0, ..., s_{N-1}. ``truth``: the (A, B) of (18).
    """
    N, x = len(inputs), record.x[k]
    return (record.models[k].predictor(N).predict(x, inputs) - truth.predictor(N).predict(x, inputs))[1:]


def omegas(record: Estimates, k: int, N: int, truth: SignalModel) -> Array:
    r"""Return omega_1(k), omega_2(k), omega_3(k) for which the bound after (8) holds with applied inputs, i = 1..N.

    With :math:`\sigma_j = |\theta^*(k+j+1)-\tilde\theta(k)|`, the newest residual :math:`e^*` of
    :math:`\theta^*(k+j+1)` and :math:`c_{ij} = 2i\,\|A(k)^{i-1-j}\|^2`, they are the largest over i of

    .. math::
        \sum_{j<i} c_{ij} |e^*|^2,\quad
        2\sum_{j<i} c_{ij} \sigma_j^2 \|A^j\|^2,\quad
        \sum_{j<i} c_{ij} \sigma_j^2 \bigl(1 + 2j \max_{l<j}\|A^{l}B\|^2\bigr).

    k + N must not exceed the number of steps.
    """
    model, exact = record.models[k], truth.predictor(N)
    growth = np.linalg.norm(model.predictor(N).A, ord=2, axis=(1, 2)) ** 2
    free = np.linalg.norm(exact.A, ord=2, axis=(1, 2)) ** 2
    forced = np.linalg.norm(exact.B, ord=2, axis=(1, 2)) ** 2
    newest, move = np.empty(N), np.empty(N)
    for j in range(N):
        best = record.best[k + j]  # theta*(k+j+1)
        newest[j] = np.sum(record.residuals(k + j + 1, best)[0] ** 2)
        move[j] = np.linalg.norm(theta_matrix(best) - theta_matrix(model), ord=2) ** 2
    found = np.zeros(3)
    for i in range(1, N + 1):
        lags = np.arange(i)
        c = 2 * i * growth[i - 1 - lags]
        largest = np.array([max(forced[:lag], default=0.0) for lag in lags])
        terms = (newest[:i], 2 * move[:i] * free[:i], move[:i] * (1 + 2 * lags * largest))
        found = np.maximum(found, [float(np.sum(c * term)) for term in terms])
    return found


def omega_sums(record: Estimates, N: int, truth: SignalModel, lambda_max: float) -> tuple[Array, Array]:
    r"""Return the sums of the three omegas over k, from the window on, and bounds of them for all data.

    Let T be the bound :math:`|\theta-\tilde\theta(0)|^2/(1-\lambda_{max})` of all squared steps and residuals, and a,
    f, b the largest norms of :math:`A(k)^i`, :math:`A^i`, :math:`A^iB` for i < N. As :math:`\sigma_j` is a sum of at
    most j + 1 steps, the sums are at most

    .. math:: 2N^2a^2T,\quad 4Na^2f^2S\,T,\quad 2Na^2(1+2Nb^2)S\,T,\qquad S = \sum_{j<N}(j+1)^2 .

    The omegas are nonnegative with finite sums, so they tend to zero for all data.
    """
    ks = range(record.window, len(record.u) - N + 1)
    sums = np.sum([omegas(record, k, N, truth) for k in ks], axis=0)
    total = record.distances(truth.theta)[0] ** 2 / (1 - lambda_max)
    exact = truth.predictor(N)
    a, f, b = (
        max(float(np.max(np.linalg.norm(powers[:N], ord=2, axis=(1, 2)))) for powers in of)
        for of in ([record.models[k].predictor(N).A for k in ks], [exact.A], [exact.B])
    )
    S = sum((j + 1) ** 2 for j in range(N))
    bounds = total * a**2 * np.array([2 * N**2, 4 * N * f**2 * S, 2 * N * (1 + 2 * N * b**2) * S])
    return sums, bounds
