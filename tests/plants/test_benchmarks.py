"""Benchmark plants against an exponential of fifty digits, and the scheme that runs on them."""

import json

import mpmath
import numpy as np
import pytest

from rhl import InputError, default_scheme, simulate
from rhl.plants.benchmarks import Benchmark, benchmark, names
from tests.plants.literature import RECORD, numbers

COMPLEIB, LITERATURE = names(collection="compleib"), names(collection="literature")


def test_there_are_two_collections():
    assert len(COMPLEIB) == 25
    assert len(names(10, "compleib")) == 19
    assert len(LITERATURE) == 17
    assert names() == COMPLEIB + LITERATURE
    assert set(names(10, "literature")) == set(LITERATURE) - {"wood-berry"}


KEPT = json.loads(RECORD.read_text(encoding="utf-8"))


@pytest.mark.parametrize("name", LITERATURE)
def test_the_numbers_of_the_literature_are_on_record(name):
    assert set(KEPT) == set(LITERATURE)
    for part, found in numbers(name).items():
        assert np.allclose(found, KEPT[name][part], rtol=1e-12, atol=0)
    assert not any(array.flags.writeable for array in (benchmark(name).A, benchmark(name).B, benchmark(name).C))


# Not stabilizable: the input does not reach the mode exp(0.1 * 0.6065), so no controller brings it to rest.
LOST = {"rea"}


@pytest.mark.parametrize("name", names())
def test_assumption_1_holds_but_for_one(name):
    assert benchmark(name).stabilizable == (name not in LOST)
    assert benchmark(name).detectable


def test_what_is_out_of_sight_is_noticed():
    deaf = Benchmark("deaf", "", np.diag([1.0, -1.0]), np.array([[0.0], [1.0]]), np.array([[0.0, 1.0]]))
    assert not deaf.stabilizable
    assert not deaf.detectable


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
    assert (benchmark("ac3").title, benchmark("pas").title) == ("COMPleib's ac3, aircraft", "COMPleib's pas")
    assert all(benchmark(name).h == 0.1 for name in COMPLEIB)


def gain(name):
    """What a constant input of one ends in, per output and input."""
    found = benchmark(name)
    rest = np.eye(len(found.A)) - found.A if found.discrete else -found.A
    return found.C @ np.linalg.solve(rest, found.B)


# As their sources print them.
POLES = {
    "aircraft-pitch": np.roots([1, 0.739, 0.921, 0]),
    "boeing-747": [-0.0073, -0.563, -0.033 + 0.947j, -0.033 - 0.947j],
    "dc-motor": [-2.0025, -9.9975],
    "doyle": [1, 1],
    "maglev": [31.3050, -31.3050, -100],
    "ogata-pendulum": [4.539, -4.539, 0, 0],
    "rohrs": [-1, -15 + 2j, -15 - 2j],
    "rosenbrock": [-1, -1, -3],
    "spinning-satellite": [10j, -10j],
    "two-mass-spring": [0, 0, 2**0.5 * 1j, -(2**0.5) * 1j],
}


def apart(one, other):
    """How far two sets of poles are apart, each pole beside its nearest, in the order of their real parts."""
    gaps = np.abs(np.sort_complex(np.round(one, 3))[:, None] - np.sort_complex(np.round(other, 3)))
    return max(gaps.min(axis=0).max(), gaps.min(axis=1).max())


@pytest.mark.parametrize("name", POLES)
def test_published_poles(name):
    assert apart(benchmark(name).poles, POLES[name]) < 2e-3
    assert apart(1.01 * benchmark(name).poles, POLES[name]) > 2e-3 or not np.any(POLES[name])


def test_published_numbers():
    # CTMS: 0.21/s^2 from the servo's angle, whose lever is 0.03 m on a beam of 1 m.
    assert np.isclose(0.03 * benchmark("ball-on-beam").A[1, 2], 0.21, atol=1e-3)
    # CTMS: the denominator z^2 - 1.511 z + 0.5488, sampled every 0.05 s, and a gain of 0.0999.
    motor = benchmark("dc-motor").sampled()
    assert np.allclose(np.poly(motor.F), [1, -1.511, 0.5488], atol=5e-4)
    assert np.allclose(gain("dc-motor"), 0.0999, atol=1e-4)
    # Erickson: the filter's corner is 1.0 kHz, its quality factor 9.5.
    frequency = np.abs(benchmark("buck-converter").poles[0])
    assert np.isclose(frequency, 2 * np.pi * 1e3, rtol=0.01)
    assert np.isclose(frequency / (2 * -benchmark("buck-converter").poles[0].real), 9.5, rtol=0.01)
    assert np.allclose(gain("buck-converter"), 28.0)
    # Ogata prints 20.601 and -0.4905.
    assert np.allclose(benchmark("ogata-pendulum").A[[1, 3], 0], [20.601, -0.4905])
    # Franklin: the yaw rate follows the rudder with -0.475 (s + 0.498)(s + 0.012 +- 0.488j) over the poles.
    aircraft = benchmark("boeing-747")
    over = np.poly(aircraft.A - aircraft.B[:, :1] @ aircraft.C[:1]) - np.poly(aircraft.A)
    assert apart(np.roots(over[1:]), [-0.498, -0.012 + 0.488j, -0.012 - 0.488j]) < 2e-3
    assert np.isclose(over[1], -0.475)
    assert np.allclose(gain("rohrs"), 2.0)
    # The reactor's temperature runs away: one pole is unstable, and the rate constant is the published one.
    reactor = benchmark("cstr")
    assert sorted(reactor.poles.real > 0) == [False, True]
    assert np.isclose(-reactor.A[0, 0] - 1.0, 7.2e10 * np.exp(-8750 / 350), rtol=1e-3)


def test_published_interaction():
    """Relative gains: 2.01 for Wood and Berry's column, 35.1 for Skogestad's, whose condition number is 141.7."""
    gains = {name: gain(name) for name in ("wood-berry", "distillation-lv")}
    relative = {name: (of * np.linalg.inv(of).T)[0, 0] for name, of in gains.items()}
    assert np.allclose(gains["wood-berry"], [[12.8, -18.9], [6.6, -19.4]])
    assert np.isclose(relative["wood-berry"], 2.01, atol=5e-3)
    assert np.isclose(relative["distillation-lv"], 35.1, atol=5e-2)
    assert np.isclose(np.linalg.cond(gains["distillation-lv"]), 141.7, atol=5e-2)


def test_delays_of_wood_and_berry():
    """The first sample at which each channel answers is one after its delay, and the answer is that of a lag."""
    plant = benchmark("wood-berry").sampled()
    answer = np.array([plant.H @ np.linalg.matrix_power(plant.F, k) @ plant.G for k in range(12)])
    assert [[int(np.flatnonzero(answer[:, i, j])[0]) for j in range(2)] for i in range(2)] == [[1, 3], [7, 3]]
    assert np.isclose(answer[1, 0, 0], 12.8 * (1 - np.exp(-1 / 16.7)))
    assert np.isclose(answer[11, 1, 0] / answer[10, 1, 0], np.exp(-1 / 10.9))


def test_a_zero_in_the_right_half_plane():
    found = benchmark("rosenbrock")
    system = lambda s: found.C @ np.linalg.solve(s * np.eye(3) - found.A, found.B)  # noqa: E731
    assert abs(np.linalg.det(system(1.0))) < 1e-15 < 1e-3 < abs(np.linalg.det(system(1.1)))
    assert np.allclose(system(2.0), [[1 / 3, 2 / 5], [1 / 3, 1 / 3]])


def test_zeros_of_the_spinning_satellite():
    found = benchmark("spinning-satellite")
    at = found.C @ np.linalg.solve(2.0 * np.eye(2) - found.A, found.B)
    assert np.allclose(at * (4 + 100), [[2 - 100, 10 * 3], [-10 * 3, 2 - 100]])


@pytest.mark.parametrize("name", LITERATURE)
def test_a_plant_of_the_literature_says_what_it_is(name):
    found = benchmark(name)
    n, q, p = len(found.A), found.B.shape[1], len(found.C)
    assert found.title
    assert found.family
    assert any(letter.isdigit() for letter in found.origin) or "Control Tutorials" in found.origin
    assert all(len(of) in (0, size) for of, size in ((found.states, n), (found.inputs, q), (found.outputs, p)))
    assert found.z0.shape == (n,)
    assert np.any(found.C @ found.z0)
    assert found.order() <= n


def test_a_plant_in_discrete_time_has_one_sampling():
    with pytest.raises(InputError, match=r"h must be 1 for wood-berry, .* discrete time, got 0\.5; leave it out"):
        benchmark("wood-berry").sampled(0.5)
    assert benchmark("wood-berry").sampled(1.0).n == 14


def test_observability_indices():
    """Of a chain of four integrators all are seen after four outputs, of a plant with its state measured after one."""
    assert benchmark("ball-on-beam").order() == 4
    assert benchmark("distillation-lv").order() == 1
    # Seven past inputs of one channel behind a lag, seen through that lag alone.
    assert benchmark("wood-berry").order() == 9


def test_parts_are_read_only():
    with pytest.raises(ValueError, match="read-only"):
        benchmark("ac1").A[0, 0] = 1.0


@pytest.mark.parametrize("name", names(10, "compleib"))
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


def test_bad_collections():
    with pytest.raises(InputError, match="collection must be one of compleib, literature, got 'slicot'"):
        names(collection="slicot")
