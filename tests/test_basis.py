"""Functions of the stacked outputs: monomials by sympy, terms read by hand, and every way to write one wrongly."""

from itertools import product

import numpy as np
import pytest
import sympy
from hypothesis import given, settings
from hypothesis import strategies as st

from rhl.basis import Features, Polynomials, Terms
from rhl.errors import InputError

SEED = 2010_05891
# A product of at most a dozen factors.
ROUNDING = 1e-14


def monomials(d, degree):
    """Exponents of all monomials of degree 2 to ``degree``, by trying all there are."""
    return {e for e in product(range(degree + 1), repeat=d) if 2 <= sum(e) <= degree}


@pytest.mark.parametrize(("p", "outputs", "degree"), [(1, 1, 4), (1, 3, 2), (2, 2, 3), (3, 1, 2), (2, 1, 5), (1, 2, 2)])
def test_polynomials_are_all_monomials(p, outputs, degree):
    expected = monomials(p * outputs, degree)
    basis = Polynomials(degree)
    assert basis.count(p, outputs) == len(expected)
    # Prime numbers tell monomials apart: each product has one factorisation.
    primes = [2, 3, 5, 7, 11, 13][: p * outputs]
    values = basis.features(np.array(primes, dtype=float), p)
    found = {tuple(sympy.factorint(int(value)).get(prime, 0) for prime in primes) for value in values}
    assert found == expected
    assert len(values) == len(expected)


def test_count_is_sympys():
    x = sympy.symbols("x:4")
    every = sympy.polys.monomials.itermonomials(x, 3, 0)
    assert Polynomials(3).count(2, 2) == sum(sympy.Poly(of, *x).total_degree() >= 2 for of in every)


@settings(max_examples=30)
@given(st.integers(1, 3), st.integers(1, 3), st.integers(2, 4))
def test_as_many_features_as_counted(p, outputs, degree):
    basis = Polynomials(degree)
    stack = np.random.default_rng(SEED).standard_normal((2, 3, p * outputs))
    together = basis.features(stack, p)
    assert together.shape == (2, 3, basis.count(p, outputs))
    assert np.array_equal(together[1, 2], basis.features(stack[1, 2], p))
    assert not np.any(basis.features(np.zeros(p * outputs), p))


# Terms

W = np.array([2.0, 3.0, 5.0, 7.0, 0.5, -1.5])  # y1, y2, then both a step before, then two steps before


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("y1*y2", 2.0 * 3.0),
        ("y1", 2.0),
        ("y2^3", 27.0),
        ("y1(k)*y2(k-0)", 6.0),
        ("y1*y2(k-1)", 2.0 * 7.0),
        ("y2(k-2)^2*y1", 1.5**2 * 2.0),
        ("y1*y1*y1", 8.0),
        ("sin(y1)", np.sin(2.0)),
        ("sin(y2(k-1))^2", np.sin(7.0) ** 2),
        ("tanh(y1(k-2))*y2", np.tanh(0.5) * 3.0),
        ("cos(y1)*y2", np.cos(2.0) * 3.0),
        ("y2*exp(y1(k-2))", 3.0 * np.exp(0.5)),
        ("cos(y1)*sin(y1)*exp(y2)", np.cos(2.0) * np.sin(2.0) * np.exp(3.0)),
        ("  y1 *\ty2 ^ 2 ", 2.0 * 9.0),
        ("sin( y1( k - 1 ) )", np.sin(5.0)),
        ("y01^01", 2.0),
        ("y1^99", 2.0**99),
    ],
)
def test_terms_by_hand(text, expected):
    terms = Terms((text,))
    assert terms.count(2, 3) == 1
    np.testing.assert_allclose(terms.features(W, 2), [expected], rtol=ROUNDING)
    np.testing.assert_allclose(terms.features(np.stack([W, 0 * W]), 2), [[expected], [0.0]], rtol=ROUNDING)


def test_terms_keep_their_order_and_may_be_a_list():
    terms = Terms(["y2", "y1", "y1*y2"])
    assert terms.texts == ("y2", "y1", "y1*y2")
    assert np.array_equal(terms.features(W, 2), [3.0, 2.0, 6.0])
    assert terms == Terms(("y2", "y1", "y1*y2"))


NO_PRODUCT = "must be a product of outputs such as .* got the factor "


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("v1", r"'v1' must use outputs only \(y1, y2, ...\), got the input v1; inputs are delay-lifted"),
        ("y1*v2(k-1)", r"'y1\*v2\(k-1\)' must use outputs only .* got the input v2"),
        ("sin(v1)", "must use outputs only"),
        ("cos(y1)", r"'cos\(y1\)' must be zero where the outputs are, .* got a value of 1 there; multiply it"),
        ("cos(y1)*exp(y2)", "must be zero where the outputs are"),
        ("exp(y1)^2", "must be zero where the outputs are"),
        ("log(y1)", r"functions: sin, tanh, cos, exp\), got the factor 'log\(y1\)'"),
        ("SIN(y1)", NO_PRODUCT),
        ("x1", NO_PRODUCT + "'x1'"),
        ("u1", NO_PRODUCT),
        ("Y1", NO_PRODUCT),
        ("y", NO_PRODUCT),
        ("y0", NO_PRODUCT),
        ("y-1", NO_PRODUCT),
        ("y1^0", NO_PRODUCT + r"'y1\^0'"),
        ("y1^00", NO_PRODUCT),
        ("y1^-1", NO_PRODUCT),
        ("y1^+1", NO_PRODUCT),
        ("y1^0.5", NO_PRODUCT),
        ("y1^", NO_PRODUCT),
        ("y1^2^2", NO_PRODUCT),
        ("y1^100", NO_PRODUCT),
        ("y1**2", NO_PRODUCT + "''"),
        ("*y1", NO_PRODUCT + "''"),
        ("y1*", NO_PRODUCT + "''"),
        ("y1+y2", NO_PRODUCT),
        ("2*y1", NO_PRODUCT + "'2'"),
        ("y1/y2", NO_PRODUCT),
        ("y1(k+1)", NO_PRODUCT),
        ("y1(k-)", NO_PRODUCT),
        ("y1(k-1", NO_PRODUCT),
        ("y1(1)", NO_PRODUCT),
        ("y1)", NO_PRODUCT),
        ("(y1)", NO_PRODUCT),
        ("sin(y1", NO_PRODUCT),
        ("sin y1", NO_PRODUCT),
        ("sin((y1))", NO_PRODUCT),
        ("sin(cos(y1))", NO_PRODUCT),
        ("sin(y1*y2)", NO_PRODUCT),
        ("sin(y1^2)", NO_PRODUCT),
        ("y1 2", NO_PRODUCT + "'y1 2'"),
        ("y1(k-1 0)", NO_PRODUCT),
        ("y1^1 0", NO_PRODUCT),
        ("y\u0661", NO_PRODUCT),
        ("y1^\u0662", NO_PRODUCT),
        ("y1\u00b2", NO_PRODUCT),
        ("\uff591", NO_PRODUCT),
        ("y1\u00b7y2", NO_PRODUCT),
        ("__import__('os')", NO_PRODUCT),
        ("", "a term must be a string such as 'y1\\*y2' of at most 200 characters, got ''"),
        (" \n", "a term must be a string"),
        ("y1" + "*y1" * 100, "a term must be a string .* got 'y1\\*y1"),
        (3, "a term must be a string .* got 3"),
        (None, "a term must be a string .* got None"),
    ],
)
def test_terms_refused(text, sentence):
    with pytest.raises(InputError, match=sentence):
        Terms((text,))


@settings(max_examples=200)
@given(st.text(alphabet="y12v()k-^* sincosexp.\u0661", max_size=12))
def test_no_text_is_read_by_accident(text):
    """Either refused in one sentence, or made of factors that can be written out again."""
    try:
        terms = Terms((text,))
    except InputError:
        return
    assert "v" not in text
    assert not terms.features(np.zeros(400), 100) or max(index for ((_, index, *_),) in terms._factors) > 100


@pytest.mark.parametrize(
    ("p", "outputs", "text", "sentence"),
    [
        (1, 2, "y1*y2", r"'y1\*y2' must use outputs y1 to y1 with delays up to 1, got y2\(k-0\)"),
        (2, 2, "y1(k-2)", r"must use outputs y1 to y2 with delays up to 1, got y1\(k-2\)"),
        (2, 1, "sin(y1(k-1))", "with delays up to 0"),
        (2, 1, "y" + "9" * 150, "must use outputs y1 to y2"),
    ],
)
def test_terms_beyond_what_is_stacked(p, outputs, text, sentence):
    with pytest.raises(InputError, match=sentence):
        Terms(("y1", text)).count(p, outputs)


# Functions of the user's own


def test_features():
    basis = Features(lambda w: [w[0] * w[1], np.sin(w[1])], 2)
    stack = np.random.default_rng(SEED).standard_normal((4, 3, 2))
    assert basis.count(1, 2) == 2
    found = basis.features(stack, 1)
    assert found.shape == (4, 3, 2)
    assert np.array_equal(found[..., 0], stack[..., 0] * stack[..., 1])
    assert Features(np.sin, 2).count(2, 1) == 2  # built in, without a signature


def fails(w):
    raise ZeroDivisionError("by what?")


@pytest.mark.parametrize(
    ("act", "sentence"),
    [
        (lambda: Polynomials(1), "degree must be an integer of at least 2, got 1"),
        (lambda: Polynomials(2.0), "degree must be an integer of at least 2, got 2.0"),
        (
            lambda: Polynomials(3).count(50, 1),
            "1 to 2000 functions, got 23375 of degree at most 3 in 50 outputs",
        ),
        (lambda: Polynomials(10**9).count(1, 1), "1 to 2000 functions, got 999999999 of degree"),
        (lambda: Terms("y1*y2"), r"texts must be one or more products such as 'y1\*y2', got 'y1\*y2'"),
        (lambda: Terms(()), r"texts must be one or more products .* got \(\)"),
        (lambda: Terms(None), "texts must be one or more products .* got None"),
        (lambda: Terms(("y1",) * 2001), "texts must be at most 2000 products, got 2001"),
        (lambda: Features(np.sin, 0), "size must be an integer of at least 1, got 0"),
        (lambda: Features(np.sin, 2001), "size must be at most 2000, got 2001"),
        (lambda: Features(3, 1), "function must be a function of the stacked outputs, got 3"),
        (lambda: Features(lambda w, v: w, 1), "function must take the stacked outputs and nothing else, got one for"),
        (lambda: Features(lambda: 0, 1), "must take the stacked outputs and nothing else"),
        (lambda: Features(lambda w: [1 + w[0]], 1).count(1, 1), r"must be zero where .* got array\(\[1.\]\); subtract"),
        (lambda: Features(lambda w: w, 3).count(1, 2), r"function must return shape \(3,\), got \(2,\)"),
        (
            lambda: Features(lambda w: w * np.nan, 2).count(1, 2),
            "must return numbers, got NaN at stacked outputs",
        ),
        (lambda: Features(lambda w: [1j * w[0]], 1).count(1, 1), "got TypeError: real numbers are needed, not complex"),
        (lambda: Features(lambda w: w * 1j, 1).count(1, 1), "got TypeError: real numbers are needed, not complex"),
        (lambda: Features(lambda w: ["0"], 1).count(1, 1), r"got TypeError: real numbers are needed, not \['0'\]"),
        (lambda: Features(lambda w: None, 1).count(1, 1), "got TypeError"),
    ],
)
def test_refused(act, sentence):
    with pytest.raises(InputError, match=sentence):
        act()


def test_what_a_function_of_the_users_raises_is_let_through():
    with pytest.raises(ZeroDivisionError, match=r"by what\?") as caught:
        Features(fails, 1).count(1, 1)
    assert caught.value.__notes__ == ["rhl called the basis function with stacked outputs of shape (1,)"]
