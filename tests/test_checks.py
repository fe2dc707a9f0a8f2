"""Arguments are copied, checked, and refused in one sentence that names, expects and tells what was found."""

import re
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as st_numpy

from rhl._checks import fraction, integer, numbers, positive, real_array, square, weight_matrix
from rhl.errors import InputError, NotFiniteError

finite = st.floats(allow_nan=False, allow_infinity=False)


@given(st_numpy.arrays(np.float64, st_numpy.array_shapes(max_dims=3, min_side=0), elements=finite))
def test_real_array_copies_to_read_only(array):
    copy = real_array("M", array)
    assert np.array_equal(copy, array)
    assert not np.shares_memory(copy, array)
    assert not copy.flags.writeable
    assert copy.dtype == np.float64


@pytest.mark.parametrize("value", [3, 3.5, [1, 2], [[1, 2], [3, 4]], np.float32(1), np.ones((2, 2), dtype=np.int8)])
def test_real_array_takes_numbers(value):
    assert np.array_equal(real_array("M", value), np.asarray(value))


@pytest.mark.parametrize(
    ("value", "shape", "sentence"),
    [
        ([[1, 2], [3]], None, "M must be a rectangular array of numbers, got [[1, 2], [3]]"),
        ("text", None, "M must hold real numbers, got 'text'"),
        (None, None, "M must hold real numbers, got None"),
        ([True, False], None, "M must hold real numbers, got [True, False]"),
        ([1j], None, "M must hold real numbers, got complex numbers"),
        ([1.0, 2.0], (3,), "M must have shape (3,), got (2,)"),
        ([1.0, 2.0], (None, 2), "M must have shape (at least 1, 2), got (2,)"),
        (np.ones((2, 0)), (2, None), "M must have shape (2, at least 1), got (2, 0)"),
        (np.ones((5, 2, 3)), (3, 2), "M must have shape (3, 2), got (5, 2, 3)"),
        ([0.0, np.nan], None, "M must be finite, got nan among its entries"),
        ([-np.inf, 0.0], (2,), "M must be finite, got -inf among its entries"),
    ],
)
def test_real_array_refuses(value, shape, sentence):
    with pytest.raises(InputError, match=f"^{re.escape(sentence)}$"):
        real_array("M", value, shape)


def test_not_finite_is_an_input_error_of_its_own():
    with pytest.raises(NotFiniteError):
        real_array("M", np.nan)
    with pytest.raises(InputError) as caught:
        real_array("M", "text")
    assert not isinstance(caught.value, NotFiniteError)


def test_long_values_are_cut():
    with pytest.raises(InputError) as caught:
        real_array("M", "x" * 1000)
    assert len(str(caught.value)) < 100
    assert str(caught.value).endswith("...")


def test_leading_axes_are_free():
    assert real_array("M", np.ones((7, 5, 2, 3)), (2, None)).shape == (7, 5, 2, 3)


def test_square():
    assert square("A", np.ones((4, 2, 2))).shape == (4, 2, 2)
    with pytest.raises(InputError, match=r"A must be square, got shape \(2, 3\)"):
        square("A", np.ones((2, 3)))


def test_weight_matrix_takes_numbers_and_matrices():
    assert np.array_equal(weight_matrix("Q", 2.0, 3), 2 * np.eye(3))
    batch = np.stack([np.eye(2), 3 * np.eye(2)])
    assert np.array_equal(weight_matrix("Q", batch, 2), batch)


def test_weight_matrix_symmetrises_rounding():
    off = np.array([[2.0, 1.0], [1.0 + 1e-15, 2.0]])
    Q = weight_matrix("Q", off, 2)
    assert np.array_equal(Q, Q.T)
    assert off[0, 1] != off[1, 0]
    assert not Q.flags.writeable


@pytest.mark.parametrize(
    ("value", "sentence"),
    [
        (0.0, "Q must be positive definite, got smallest eigenvalue 0"),
        (-1, "Q must be positive definite, got smallest eigenvalue -1"),
        ([1.0, 2.0], "Q must be a number or a matrix of shape (2, 2), got shape (2,)"),
        (np.eye(3), "Q must be a number or a matrix of shape (2, 2), got shape (3, 3)"),
        ([[1.0, 0.5], [0.0, 1.0]], "Q must be symmetric, got entries that differ from their mirror by 0.5"),
        ([[1.0, 1e-11], [0.0, 1.0]], "Q must be symmetric, got entries that differ from their mirror by 1e-11"),
        ([[1.0, 2.0], [2.0, 1.0]], "Q must be positive definite, got smallest eigenvalue -1"),
        ([np.eye(2), -np.eye(2)], "Q must be positive definite, got smallest eigenvalue -1"),
        ([[np.nan, 0.0], [0.0, 1.0]], "Q must be finite, got nan among its entries"),
    ],
)
def test_weight_matrix_refuses(value, sentence):
    with pytest.raises(InputError, match=f"^{re.escape(sentence)}$"):
        weight_matrix("Q", value, 2)


@pytest.mark.parametrize(
    "value", [3, 2.5, [1, 2], np.float32(1), np.nan, [np.inf], Fraction(1, 2), [Fraction(1, 4), 1]]
)
def test_numbers_takes_what_holds_numbers(value):
    found = numbers(value)
    assert found.dtype == np.float64
    np.testing.assert_array_equal(found, np.asarray(value, dtype=np.float64))


@pytest.mark.parametrize("value", [None, [1.0, None], "3", ["3"], 1j, np.complex128(1), [1j], True, [[1], [2, 3]]])
def test_numbers_refuses(value):
    """Where numpy would take NaN for None, read a string, or drop an imaginary part."""
    with pytest.raises((TypeError, ValueError)):
        numbers(value)


@pytest.mark.parametrize("value", [1, 5, np.int64(2)])
def test_integer_takes(value):
    assert integer("N", value, 1) == value
    assert type(integer("N", value, 1)) is int


@pytest.mark.parametrize("value", [0, -3, 1.0, 2.5, True, "3", None, np.nan])
def test_integer_refuses(value):
    sentence = f"N must be an integer of at least 1, got {value!r}"
    with pytest.raises(InputError, match=f"^{re.escape(sentence)}$"):
        integer("N", value, 1)


@pytest.mark.parametrize(
    ("check", "taken", "refused", "wanted"),
    [
        (positive, [1, 0.5, 1e-300], [0, -1.0, np.inf, np.nan, True, "1", None, 1j], "a positive finite number"),
        (fraction, [0, 0.5, 1 - 1e-16], [1, 1.0, -0.1, np.nan, False, [0.5]], r"a number in [0, 1)"),
    ],
)
def test_numbers_in_a_range(check, taken, refused, wanted):
    assert [check("c", value) for value in taken] == [float(value) for value in taken]
    for value in refused:
        with pytest.raises(InputError, match=f"^{re.escape(f'c must be {wanted}, got {value!r}')}$"):
            check("c", value)
