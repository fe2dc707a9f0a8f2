"""Benchmark plants against an exponential of fifty digits, and the scheme that runs on them."""

import mpmath
import numpy as np
import pytest

from rhl import InputError, default_scheme, simulate
from rhl.plants.analysis import detectability, stabilizability
from rhl.plants.benchmarks import benchmark, names


def test_there_are_twenty_five():
    assert len(names()) == 25
    assert len(names(largest=10)) == 19
    assert len(names(largest=30)) - len(names(largest=10)) == 6


# Not stabilizable: the input does not reach the mode exp(0.1 * 0.6065), so no controller brings it to rest.
LOST = {"rea"}


@pytest.mark.parametrize("name", names())
def test_assumption_1_holds_but_for_one(name):
    plant = benchmark(name).sampled()
    # Units of the input decide nothing here: those of `pas` move its outputs by 1e-7.
    assert stabilizability(plant.F, plant.G / np.abs(plant.G).max()).holds == (name not in LOST)
    assert detectability(plant.F, plant.H / np.abs(plant.H).max()).holds


@pytest.mark.parametrize("name", ["ac3", "dis2", "he1", "toy"])
def test_sampling_against_an_exponential_of_fifty_digits(name):
    found, h = benchmark(name), 0.3
    n, q = found.B.shape
    with mpmath.workdps(50):
        whole = mpmath.zeros(n + q)
        for i in range(n):
            for j in range(n):
                whole[i, j] = mpmath.mpf(found.A[i, j]) * h
            for j in range(q):
                whole[i, n + j] = mpmath.mpf(found.B[i, j]) * h
        exact = np.array(mpmath.expm(whole, method="taylor").tolist(), dtype=np.float64)
    plant = found.sampled(h)
    scale = np.abs(exact).max()
    assert np.abs(plant.F - exact[:n, :n]).max() < 1e-12 * scale
    assert np.abs(plant.G - exact[:n, n:]).max() < 1e-12 * scale
    assert np.abs(found.sampled(0.31).F - exact[:n, :n]).max() > 1e-6


def test_numbers_of_the_source():
    # The toy plant is an undamped oscillator of frequency one, whose exponential is a rotation.
    toy = benchmark("toy")
    plant = toy.sampled(0.1)
    assert np.allclose(plant.F, [[np.cos(0.1), np.sin(0.1)], [-np.sin(0.1), np.cos(0.1)]], atol=1e-15)
    assert benchmark("rea").order() == 8
    assert benchmark("ac3").family == "aircraft"
    assert np.isclose(np.linalg.norm(benchmark("je1").z0), 1.0)


def test_parts_are_read_only():
    with pytest.raises(ValueError, match="read-only"):
        benchmark("ac1").A[0, 0] = 1.0


@pytest.mark.parametrize("name", names(largest=10))
def test_the_default_scheme_brings_it_to_rest(name):
    found = benchmark(name)
    plant = found.sampled()
    trace = simulate(default_scheme(plant.p, plant.q, found.order()), plant, found.z0, 400)
    size = np.abs(trace.y).max(axis=1) / np.abs(trace.y[0]).max()
    assert bool(np.all(size[-20:] < 0.05)) == (name not in LOST)
    assert bool(size.max() < 100) == (name not in LOST)


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("ac11", "benchmark must be one of ac1, ac10, got 'ac11'"),
        ("nothing like it", "benchmark must be one of ac1, ac10, .* got 'nothing like it'"),
        (1, "benchmark must be one of .* got 1"),
        (None, "benchmark must be one of .* got None"),
    ],
)
def test_unknown_names(name, sentence):
    with pytest.raises(InputError, match=sentence):
        benchmark(name)


@pytest.mark.parametrize("h", [0, -1, np.nan, "1", 1e6])
def test_bad_sampling(h):
    with pytest.raises(InputError, match="h must be"):
        benchmark("ac3").sampled(h)


@pytest.mark.parametrize("largest", [0, 1.5, "a"])
def test_bad_orders(largest):
    with pytest.raises(InputError, match="largest must be an integer of at least 1"):
        names(largest)
