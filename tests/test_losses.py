"""Losses, generators and the Bregman distance against 1300 digits, closed forms, and what each declares of itself."""

import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as st_numpy

from rhl import losses
from rhl.errors import InputError
from rhl.estimator import ProximalEstimator
from rhl.losses import CustomLoss, Entropy, LogCosh, PseudoHuber, Varying, WeightedSquares, _convex, convex, divergence
from rhl.model import SignalModel

EPS = np.finfo(float).eps
# A handful of operations, each within an ulp.
ULPS = 8 * EPS
# log cosh at 1e-300 differs from zero in the 600th digit; differentiated twice, it needs as many again.
DIGITS = 1300
# Forward differences of a gradient: their width, 1e-8, times third derivatives of order one.
DIFFERENCES = 1e-6
# Three terms of the size of |x|^2 + |y|^2 cancel.
ROUNDING = 1e-14

entries = st.floats(-1e6, 1e6)
vectors = st_numpy.arrays(np.float64, 3, elements=entries)
weights = st_numpy.arrays(np.float64, 3, elements=st.floats(1e-3, 1e3))


@given(weights, vectors, vectors)
def test_distance_of_weighted_squares(weight, x, y):
    expected = np.sum(weight * (x - y) ** 2)
    scale = np.sum(weight * (x**2 + y**2)) + 1
    np.testing.assert_allclose(divergence(WeightedSquares(weight), x, y), expected, atol=ROUNDING * scale)


@given(vectors)
def test_distance_to_itself_is_zero(x):
    assert divergence(WeightedSquares(), x, x) == 0


@pytest.mark.parametrize("g", [WeightedSquares([1.0, 2.0, 0.5]), Entropy()])
def test_distance_is_positive_between_different_points(g):
    x, y = np.array([1.0, 2.0, 3.0]), np.array([2.0, 2.0, 1.0])
    assert divergence(g, x, y) > 0.1
    assert divergence(g, y, x) > 0.1


def test_distance_follows_its_definition_for_other_generators():
    x, y = np.array([1.0, 2.0, 3.0]), np.array([2.0, 2.0, 1.0])
    kullback_leibler = np.sum(x * np.log(x / y) - x + y)
    np.testing.assert_allclose(divergence(Entropy(), x, y), kullback_leibler, rtol=ROUNDING)
    # It is not symmetric, so the order of the arguments is tested too.
    assert abs(divergence(Entropy(), y, x) - kullback_leibler) > 0.1


@pytest.mark.parametrize("weight", [1.0, 2.5, [1.0, 2.0, 0.5]])
def test_gradient_is_the_slope_of_value(weight):
    g, x = WeightedSquares(weight), np.array([1.0, -2.0, 3.0])
    h = 1e-5  # a quadratic's central difference is exact but for rounding, 1e-16 / h
    slopes = [(g.value(x + h * e) - g.value(x - h * e)) / (2 * h) for e in np.eye(3)]
    np.testing.assert_allclose(g.gradient(x), slopes, rtol=1e-9)


def test_batches_agree_with_members():
    rng = np.random.default_rng(2010_05891)
    x, y, g = rng.standard_normal((4, 5, 3)), rng.standard_normal((4, 5, 3)), WeightedSquares([1.0, 2.0, 0.5])
    together = divergence(g, x, y)
    assert together.shape == (4, 5)
    for i, j in np.ndindex(4, 5):
        np.testing.assert_allclose(together[i, j], divergence(g, x[i, j], y[i, j]), rtol=ROUNDING)


def test_weights_are_read_only():
    with pytest.raises(ValueError, match="read-only"):
        WeightedSquares([1.0, 2.0]).weight[0] = 3.0


@pytest.mark.parametrize(
    ("weight", "sentence"),
    [
        (0.0, r"weight must be positive, .* got 0.0"),
        ([1.0, -2.0], r"weight must be positive, .* got -2.0"),
        ([], "weight must be positive, .* got no entry"),
        (np.inf, "weight must be finite, got inf"),
        ("one", "weight must hold real numbers, got 'one'"),
    ],
)
def test_refused(weight, sentence):
    with pytest.raises(InputError, match=sentence):
        WeightedSquares(weight)


# Values, gradients and second derivatives over the whole range of float64

MAGNITUDES = [1e-300, 1e-160, 1e-30, 1e-9, 0.99e-8, 1.01e-8, 1e-4, 0.1, 0.7, 0.999, 1.001, 3.0, 30.0, 300.0]
MAGNITUDES += [1e4, 1e9, 1e30, 1e160, 1e300]


def log_cosh(x, w, s):
    return 2 * w * s**2 * mpmath.log(mpmath.cosh(x / s))


def pseudo_huber(x, w, s):
    return 2 * w * s**2 * (mpmath.sqrt(1 + (x / s) ** 2) - 1)


def close_to(found, exact, rtol):
    """Relative to the exact number, down to where float64 has no more numbers."""
    exact = float(exact)
    assert np.isfinite(found)
    assert abs(float(found) - exact) <= rtol * abs(exact) + 1e-307


def bend_rtol(x, s):
    """Falling exponentially, log cosh's second derivative multiplies the rounding of x / s by 2 x / s."""
    return ULPS * (1 + 2 * abs(x) / s)


@pytest.mark.parametrize("scale", [1.0, 0.3, 7.0])
@pytest.mark.parametrize(("kind", "formula"), [(LogCosh, log_cosh), (PseudoHuber, pseudo_huber)])
def test_robust_losses_are_their_formulas(kind, formula, scale):
    c, weight = kind(scale, [1.7]), 1.7
    with mpmath.workdps(DIGITS):
        for size in MAGNITUDES:
            for x in (size, -size):
                point = np.array([x])
                close_to(c.value(point), formula(mpmath.mpf(x), weight, mpmath.mpf(scale)), ULPS)
                t = mpmath.mpf(x) / mpmath.mpf(scale)
                if kind is LogCosh:
                    slope, bend = scale * mpmath.tanh(t), mpmath.sech(t) ** 2 if size < 1e4 else 0
                else:
                    slope, bend = x / mpmath.sqrt(1 + t**2), (1 + t**2) ** mpmath.mpf(-1.5)
                close_to(c.gradient(point)[0], 2 * weight * slope, ULPS)
                close_to(c.hessian(point)[0], 2 * weight * bend, bend_rtol(x, scale))


@pytest.mark.parametrize(("kind", "formula"), [(LogCosh, log_cosh), (PseudoHuber, pseudo_huber)])
def test_derivatives_are_those_of_the_formula(kind, formula):
    """The oracle above writes derivatives down; here they are taken of the formula itself."""
    with mpmath.workdps(200):  # log cosh bends by 1e-87 at the first of these
        for x in (-30.0, -1.001, -0.1, 0.5, 0.999, 3.0):
            slope, bend = (mpmath.diff(lambda at: formula(at, 1, mpmath.mpf(0.3)), x, order) for order in (1, 2))
            close_to(kind(0.3).gradient(np.array([x]))[0], slope, ULPS)
            close_to(kind(0.3).hessian(np.array([x]))[0], bend, bend_rtol(x, 0.3))
            # The control: another scale has other derivatives.
            assert abs(float(slope) - kind(0.4).gradient(np.array([x]))[0]) > 1e-6


def test_entropy_is_its_formula():
    g = Entropy([1.7])
    with mpmath.workdps(60):
        for x in MAGNITUDES:
            exact, point = mpmath.mpf(x), np.array([x])
            close_to(g.value(point), 1.7 * exact * mpmath.log(exact), ULPS)
            # 1 + log x cancels near 1/e, where none of these points lies.
            close_to(g.gradient(point)[0], 1.7 * (1 + mpmath.log(exact)), ULPS)
            close_to(g.hessian(point)[0], 1.7 / exact, ULPS)
    assert g.value(np.array([0.0])) == 0
    assert g.value(np.array([-1e-300])) == np.inf


@pytest.mark.parametrize("scale", [1e-200, 1e-6, 1e200])
@pytest.mark.parametrize("kind", [LogCosh, PseudoHuber])
def test_any_scale(kind, scale):
    """Neither the square of the scale nor that of x / s need be in range."""
    x, c = np.array([1.0]), kind(scale)
    expected = 1.0 if scale > 1 else 2 * scale
    # Beyond s the next term is s log 2 or s, relative to |x|.
    np.testing.assert_allclose(c.value(x), expected, rtol=max(ULPS, 2 * scale if scale < 1 else 0))
    np.testing.assert_allclose(c.gradient(x), 2.0 if scale > 1 else 2 * scale, rtol=max(ULPS, min(scale, 1e-11)))


@pytest.mark.parametrize("kind", [LogCosh, PseudoHuber])
def test_a_large_scale_gives_weighted_squares(kind):
    rng = np.random.default_rng(0)
    x, weight = rng.standard_normal((20, 3)), np.array([1.0, 2.0, 0.5])
    squares, c = WeightedSquares(weight), kind(1e9, weight)
    for found, expected in ((c.value, squares.value), (c.gradient, squares.gradient), (c.hessian, squares.hessian)):
        np.testing.assert_allclose(found(x), expected(x), rtol=ULPS)
    assert np.max(np.abs(kind(10.0, weight).value(x) / squares.value(x) - 1)) > 1e-4


@pytest.mark.parametrize("kind", [LogCosh, PseudoHuber])
def test_large_residuals_count_linearly(kind):
    c, x = kind(0.5, [3.0]), np.array([1e9])
    assert c.value(3 * x) - c.value(2 * x) == pytest.approx(2 * 3 * 0.5 * 1e9, rel=1e-9)
    assert WeightedSquares([3.0]).value(2 * x) / WeightedSquares([3.0]).value(x) == 4


GENERATORS = {
    **{f"{name} by default": kind() for name, kind in (losses.LOSSES | losses.GENERATORS).items()},
    "squares": WeightedSquares([1.0, 2.0, 0.5]),
    "matrix": WeightedSquares([[2.0, 0.5, 0.0], [0.5, 1.0, 0.1], [0.0, 0.1, 3.0]]),
    "log-cosh": LogCosh(0.7, [1.0, 2.0, 0.5]),
    "pseudo-huber": PseudoHuber(0.7, [1.0, 2.0, 0.5]),
    "entropy": Entropy([1.0, 2.0, 0.5]),
    "own": CustomLoss(lambda x: x @ x + np.sum(np.exp(x)), lambda x: 2 * x + np.exp(x), lambda x: 2 + np.exp(x)),
    "own-differences": CustomLoss(lambda x: x @ x + np.sum(np.exp(x)), lambda x: 2 * x + np.exp(x)),
    "own-separable": CustomLoss(lambda x: x @ x + np.sum(np.exp(x)), lambda x: 2 * x + np.exp(x), separable=True),
    "own-matrix": CustomLoss(
        lambda x: x @ x + np.log(np.sum(np.exp(x))),
        lambda x: 2 * x + np.exp(x) / np.sum(np.exp(x)),
    ),
}
named = pytest.mark.parametrize("g", GENERATORS.values(), ids=GENERATORS)


def points(g, *shape):
    drawn = np.random.default_rng(2010_05891).standard_normal(shape) * 2
    return drawn if g.lower == -np.inf else np.exp(drawn)


@named
def test_gradient_and_hessian_are_slopes(g):
    h = 1e-5  # central differences: h^2 of truncation and 1e-16 / h of rounding
    for x in points(g, 5, 3):
        steps = h * np.eye(3) * np.minimum(np.abs(x), 1)
        width = np.diag(steps)
        slopes = [(g.value(x + e) - g.value(x - e)) / (2 * w) for e, w in zip(steps, width, strict=True)]
        bends = np.array([(g.gradient(x + e) - g.gradient(x - e)) / (2 * w) for e, w in zip(steps, width, strict=True)])
        np.testing.assert_allclose(g.gradient(x), slopes, rtol=1e-8, atol=1e-8)
        found = g.hessian(x)
        np.testing.assert_allclose(np.diag(found) if found.ndim == 1 else found, bends, rtol=1e-5, atol=1e-5)


@named
def test_batches_of_every_kind_agree_with_members(g):
    x = points(g, 4, 2, 3)
    for function in (g.value, g.gradient, g.hessian):
        together = function(x)
        for index in np.ndindex(4, 2):
            np.testing.assert_allclose(together[index], function(x[index]), rtol=ULPS, atol=ULPS)


@pytest.mark.parametrize("differing", ["own-differences", "own-matrix"])
def test_differences_of_the_gradient(differing):
    g = GENERATORS[differing]
    for x in points(g, 10, 3):
        p = np.exp(x) / np.sum(np.exp(x))
        exact = 2 * np.eye(3) + (np.diag(np.exp(x)) if differing == "own-differences" else np.diag(p) - np.outer(p, p))
        assert np.array_equal(g.hessian(x), g.hessian(x).T)
        assert np.max(np.abs(g.hessian(x) - exact)) < DIFFERENCES * np.max(exact)


def test_differences_of_what_is_separable_are_one():
    calls = []
    g = own(gradient=lambda x: calls.append(1) or 2 * x, separable=True)
    np.testing.assert_allclose(g.hessian(np.array([1.0, 0.0, -3.0])), [2.0, 2.0, 2.0], rtol=DIFFERENCES)
    assert len(calls) == 2
    assert np.array_equal(GENERATORS["own-separable"].hessian(X), np.diag(GENERATORS["own-differences"].hessian(X)))


def test_differences_stay_inside_the_domain():
    """Forward only: x log x has no value left of zero, and its slope bends by 1/x."""
    g = CustomLoss(lambda x: np.sum(x * np.log(x)), lambda x: 1 + np.log(x), lower=0.0)
    x = np.array([0.01, 1.0, 50.0])
    np.testing.assert_allclose(g.hessian(x), np.diag(1 / x), rtol=1e-5, atol=1e-7)
    assert g.hessian(np.array([2.0])).shape == (1, 1)


def test_own_has_no_value_outside_its_domain():
    called = []
    g = CustomLoss(lambda x: called.append(x) or 1.0, lambda x: x, lower=0.0)
    assert np.array_equal(g.value(np.array([[1.0, 2.0], [0.0, 1.0], [-1.0, 1.0]])), [1.0, np.inf, np.inf])
    assert len(called) == 1


# What each declares of itself, against samples


def worst_of_convexity(of, a, b):
    """How far the middle lies above the chord, relative to the chord's ends; positive: not convex."""
    high = (of(a) + of(b)) / 2
    return np.max((of((a + b) / 2) - high) / (np.abs(of(a)) + np.abs(of(b)) + 1e-3))


def in_second(g):
    """The same of y -> D(x, y), over x."""
    x, a, b = points(g, 3, 1000, 3)
    return worst_of_convexity(lambda y: divergence(g, x, y), a, b)


@named
def test_declared_convexity_in_the_second_argument(g):
    """Rounding leaves 1e-13 of three terms that cancel; where it is declared to fail, a sample shows it."""
    if g.convex_in_second:
        assert in_second(g) < 1e-12
    elif g.convex_in_second is False:
        assert in_second(g) > 1e-2
    else:
        assert isinstance(g, CustomLoss)


def monotone(g):
    """The least slope between two points, relative to their distance: positive for what is strictly convex."""
    x, y = points(g, 2, 1000, 3)
    return np.min(np.sum((x - y) * (g.gradient(x) - g.gradient(y)), axis=-1) / np.sum((x - y) ** 2, axis=-1))


@named
def test_declared_strict_convexity(g):
    if g.assumption_6 is None:
        assert isinstance(g, CustomLoss)
    else:
        assert g.assumption_6
        assert monotone(g) > 0
        if g.lower == -np.inf:
            assert g.value(np.zeros(3)) == 0
            assert np.min(g.value(points(g, 1000, 3))) > 0


def test_samples_find_what_is_not_convex():
    wavy = CustomLoss(lambda x: np.sum(x**2 / 4 + np.cos(x)), lambda x: x / 2 - np.sin(x), lambda x: 0.5 - np.cos(x))
    assert monotone(wavy) < -0.1
    assert in_second(wavy) > 1e-2


# Distances


def test_matrix_weights():
    W = np.array([[2.0, 0.5], [0.5, 1.0]])
    g, x, y = WeightedSquares(W), np.array([[1.0, -2.0], [3.0, 0.5]]), np.array([0.3, 0.7])
    np.testing.assert_allclose(g.value(x), [point @ W @ point for point in x], rtol=ULPS)
    np.testing.assert_allclose(g.gradient(x), [2 * W @ point for point in x], rtol=ULPS)
    assert np.array_equal(g.hessian(x), [2 * W, 2 * W])
    np.testing.assert_allclose(divergence(g, x, y), [(d @ W @ d) for d in x - y], rtol=ROUNDING)
    diagonal = WeightedSquares(np.diag([2.0, 3.0]))
    np.testing.assert_allclose(diagonal.value(x), WeightedSquares([2.0, 3.0]).value(x), rtol=ULPS)


@given(
    st_numpy.arrays(np.float64, 3, elements=st.floats(0, 1e6)),
    st_numpy.arrays(np.float64, 3, elements=st.floats(1e-6, 1e6)),
)
def test_distance_of_entropy_is_kullbacks_and_leiblers(x, y):
    with mpmath.workdps(60):
        exact = sum(
            (mpmath.mpf(a) * mpmath.log(mpmath.mpf(a) / mpmath.mpf(b)) if a else 0) - mpmath.mpf(a) + mpmath.mpf(b)
            for a, b in zip(x, y, strict=True)
        )
    scale = np.sum((x + y) * 20) + 1  # logarithms of these are below 20
    np.testing.assert_allclose(divergence(Entropy(), x, y), float(exact), atol=ROUNDING * scale)


@pytest.mark.parametrize(("x", "y"), [([-1.0, 1.0], [1.0, 1.0]), ([1.0, 1.0], [0.0, 1.0]), ([1.0, 1.0], [-2.0, 1.0])])
def test_distance_outside_the_domain_is_refused(x, y):
    with pytest.raises(InputError, match=r"x and y must lie in the domain of Entropy, .* got entries from -?\d"):
        divergence(Entropy(), x, y)
    assert divergence(Entropy(), [0.0, 1.0], [1.0, 1.0]) == pytest.approx(1.0)


# What is refused


def fails(x):
    raise KeyError("gain")


def own(**changes):
    return CustomLoss(**{"value": lambda x: x @ x, "gradient": lambda x: 2 * x, "name": "mine"} | changes)


X = np.array([1.0, 2.0])


@pytest.mark.parametrize(
    ("act", "sentence"),
    [
        (lambda: own(value=3.0), "value must be a function of x, got 3.0"),
        (lambda: own(gradient=None), "gradient must be a function of x, got None"),
        (lambda: own(hessian="2"), "hessian must be a function of x, got '2'"),
        (lambda: own(lower=np.nan), "lower must be a number or -inf, got nan"),
        (lambda: own(lower=np.inf), "lower must be a number or -inf, got inf"),
        (lambda: own(lower=True), "lower must be a number or -inf, got True"),
        (lambda: own(separable=1), "separable must be True or False, got 1"),
        (lambda: own(lower="0"), "lower must be a number or -inf, got '0'"),
        (
            lambda: own(value=lambda x: 1j).value(X),
            "mine's function 'value' must return real numbers, got TypeError: real numbers are needed, not complex",
        ),
        (lambda: own(value=lambda x: np.complex128(1)).value(X), "real numbers are needed, not complex numbers"),
        (lambda: own(value=lambda x: "3").value(X), "real numbers are needed, not '3'"),
        (lambda: own(value=lambda x: None).value(X), "'value' must return real numbers, got TypeError: .* 'NoneType'"),
        (lambda: own(value=lambda x: x).value(X), r"mine's function 'value' must return shape \(\), got \(2,\)"),
        (
            lambda: own(value=lambda x: np.nan).value(X),
            r"'value' must return finite numbers in its domain, got \[nan\] at x",
        ),
        (lambda: own(gradient=lambda x: x[:1]).gradient(X), r"'gradient' must return shape \(2,\), got \(1,\)"),
        (lambda: own(gradient=lambda x: x * np.inf).gradient(X), r"entries from 1 to 2; set lower where the domain is"),
        (
            lambda: own(hessian=lambda x: np.ones((1, 2))).hessian(X),
            r"'hessian' must return shape \(2,\) or \(2, 2\), got \(1, 2\)",
        ),
        (lambda: own(hessian=lambda x: x * np.nan).hessian(X), "'hessian' must return finite numbers"),
        (lambda: LogCosh(0.0), "scale must be a positive finite number, got 0.0"),
        (lambda: PseudoHuber(np.inf), "scale must be a positive finite number, got inf"),
        (lambda: LogCosh(1.0, np.eye(2)), r"weight must be positive, one number or shape \(d,\), got shape \(2, 2\)"),
        (lambda: Entropy(-1.0), "weight must be positive, one number .* got -1.0"),
        (lambda: PseudoHuber(1.0, []), r"weight must be positive, .* got shape \(0,\)"),
        (lambda: WeightedSquares(np.ones((1, 2, 2))), r"weight must be positive, .* got shape \(1, 2, 2\)"),
        (lambda: WeightedSquares([[1.0, 2.0], [2.0, 1.0]]), "weight must be positive definite, got smallest"),
        (lambda: WeightedSquares([[1.0, 0.5], [0.0, 1.0]]), "weight must be symmetric"),
        (lambda: Varying(LogCosh()), r"at must be a function of k that returns a loss, got LogCosh\("),
        (lambda: Varying(lambda k: 2.0).loss(0), r"at\(k\) must be a loss or generator .* got 2.0 without value"),
        (lambda: convex("loss", np.ones(2)), "loss must be a loss or generator .* without value"),
    ],
)
def test_refused_of_every_kind(act, sentence):
    with pytest.raises(InputError, match=sentence):
        act()


@pytest.mark.parametrize(
    ("act", "note"),
    [
        (lambda: own(value=fails).value(X), "mine's function 'value' raised this at x of shape (2,)"),
        (lambda: own(gradient=fails).gradient(np.ones((4, 2))), "'gradient' raised this at x of shape (2,)"),
        (lambda: own(gradient=fails).hessian(X), "'gradient' raised this at x of shape (2,)"),
        (lambda: own(hessian=fails).hessian(X), "'hessian' raised this at x of shape (2,)"),
        (lambda: Varying(fails).loss(7), "Varying loss raised this at k = 7"),
    ],
)
def test_what_a_users_function_raises_comes_through(act, note):
    with pytest.raises(KeyError) as caught:
        act()
    assert caught.value.args == ("gain",)
    assert len(caught.value.__notes__) == 1
    assert note in caught.value.__notes__[0]


# The register


def test_files_and_messages_read_the_register():
    robust = {"squares": WeightedSquares, "log-cosh": LogCosh, "pseudo-huber": PseudoHuber}
    assert robust.items() <= losses.LOSSES.items()
    assert "entropy" not in losses.LOSSES
    assert {"squares": WeightedSquares, "entropy": Entropy}.items() <= losses.GENERATORS.items()
    assert "log-cosh" not in losses.GENERATORS
    for role, offers in (("file_loss", losses.LOSSES), ("file_generator", losses.GENERATORS)):
        for kind in offers.values():
            settings = getattr(kind, role)
            made = kind(**dict.fromkeys(settings, 2.0))
            assert all(getattr(made, setting) == 2.0 for setting in settings)


def test_a_new_loss_needs_one_place(monkeypatch):
    """The class says everything: the estimator takes it, messages name it, files offer it."""
    monkeypatch.setattr(_convex, "KNOWN", [*_convex.KNOWN])
    for offers in (losses.LOSSES, losses.GENERATORS):
        monkeypatch.setattr(_convex, "LOSSES" if offers is losses.LOSSES else "GENERATORS", dict(offers))

    @losses.registered
    class Fair:
        """Fair's function, |e| - log(1 + |e|), twice, entry by entry."""

        lower, assumption_6, convex_in_second = -np.inf, True, False
        file_name, file_loss, file_generator = "fair", (), None

        def value(self, x):
            return 2 * np.sum(np.abs(x) - np.log1p(np.abs(x)), axis=-1)

        def gradient(self, x):
            return 2 * x / (1 + np.abs(x))

        def hessian(self, x):
            return 2 / (1 + np.abs(x)) ** 2

    assert _convex.LOSSES["fair"] is Fair
    assert "fair" not in _convex.GENERATORS
    with pytest.raises(InputError, match=r"Entropy.*, Fair, or CustomLoss"):
        convex("loss", 3)
    rng = np.random.default_rng(0)
    centre, x, u = SignalModel(np.eye(2), np.ones((2, 1))), rng.standard_normal((4, 2)), rng.standard_normal((3, 1))
    made = ProximalEstimator(3, Fair())
    assert made.newton_decrement(made.minimise(centre, x, u), centre, x, u) < 1e-12


def test_own_takes_what_holds_numbers():
    """A list, an integer, a number of extended precision."""
    g = own(value=lambda x: mpmath.mpf(3), gradient=lambda x: [1, 2], hessian=lambda x: [[2, 0], [0, 2]])
    assert g.value(X) == 3
    assert np.array_equal(g.gradient(X), [1.0, 2.0])
    assert np.array_equal(g.hessian(np.stack([X, X])), [2 * np.eye(2)] * 2)


def test_varying_is_the_loss_of_each_step():
    by_step = Varying(lambda k: LogCosh(1.0 + k))
    assert [by_step.loss(k).scale for k in (0, 3)] == [1.0, 4.0]
