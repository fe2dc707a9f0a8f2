"""Plants by number: the same whoever asks, distributed as said, with the modes that were asked for."""

import numpy as np
import pytest

from rhl import InputError
from rhl.plants.analysis import detectability, observability_index, pbh, spectral_radius, stabilizability
from rhl.plants.benchmarks import benchmark
from rhl.study.ensembles import BenchmarkPlants, RandomPlants

# Eigenvalues that are scattered by rounding, and by the coordinates.
_TOL = 1e-9


def drawn(plants):
    return [plants.draw(i) for i in range(len(plants))]


def same(one, other):
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in ("F", "G", "H", "z0"))


def test_a_plant_is_the_child_of_the_seed_with_its_number():
    plants = RandomPlants(7, 3, n=(2, 4), p=(1, 2))
    for i, rng in enumerate(
        np.random.default_rng(child) for of in np.random.SeedSequence(7).spawn(4) for child in of.spawn(3)
    ):
        n = plants.draw(i).size[0]
        core = rng.standard_normal((n, n))
        # In coordinates with a condition number of one, eigenvalues are those of the core, scaled.
        found, wanted = np.linalg.eigvals(plants.draw(i).F), np.linalg.eigvals(core)
        ratio = spectral_radius(plants.draw(i).F) / spectral_radius(core)
        assert np.allclose(np.sort_complex(found), np.sort_complex(wanted * ratio), atol=_TOL)


def test_more_of_them_leave_the_first_as_they_were():
    few, many = RandomPlants(1, 2, n=(2, 3)), RandomPlants(1, 50, n=(2, 3))
    assert all(same(few.draw(i), many.draw(at)) for i, at in enumerate((0, 1, 50, 51)))
    assert not same(few.draw(0), few.draw(1))
    assert not same(few.draw(0), RandomPlants(2, 2, n=(2, 3)).draw(0))
    assert few.errors(2).generate_state(1) == many.errors(50).generate_state(1) != many.errors(51).generate_state(1)


def test_sampling_times_belong_to_one_plant():
    plants = RandomPlants(1, 2, n=(3,), growth=(-1.0, 1.0), sampling=(0.1, 0.2))
    fast, slow = plants.draw(1), plants.draw(3)
    assert (fast.sampling, slow.sampling) == (0.1, 0.2)
    assert np.allclose(fast.F @ fast.F, slow.F, atol=_TOL)
    assert np.allclose(fast.F @ fast.G + fast.G, slow.G, atol=_TOL)
    assert plants.errors(1).spawn_key == plants.errors(3).spawn_key != plants.errors(0).spawn_key


def test_sizes_and_radii():
    plants = RandomPlants(3, 40, n=(2, 5), p=(1, 2), q=(1, 3), radius=(0.6, 1.4), conditioning=100.0)
    assert len(plants) == 320
    radii = []
    for one in drawn(plants):
        n, p, q, bound = one.size
        assert bound == -(-n // p) == observability_index(one.F, one.H)
        assert (p, q, bound) in plants.sizes()
        assert np.isclose(np.linalg.norm(one.z0), 1.0)
        radii.append(spectral_radius(one.F))
    assert 0.6 - _TOL <= min(radii) < 0.62
    assert 1.38 < max(radii) <= 1.4 + _TOL
    assert abs(np.mean(radii) - 1.0) < 0.05


def test_rates_of_growth():
    rates = [
        np.log(spectral_radius(one.F)) / 0.25
        for one in drawn(RandomPlants(3, 60, growth=(-0.3, 0.7), sampling=(0.25,), hidden=1))
        if spectral_radius(one.F) > 1
    ]
    assert 30 < len(rates) < 60
    assert 0.5 < max(rates) <= 0.7 + _TOL


def test_hidden_modes_are_stable_and_hidden():
    kinds = set()
    for one in drawn(RandomPlants(5, 40, n=(4,), hidden=2, radius=(1.05, 1.2), conditioning=10.0)):
        assert stabilizability(one.F, one.G).holds
        assert detectability(one.F, one.H).holds
        reached, seen = pbh(one.F, one.G) > 1e-7, pbh(one.F.T, one.H.T) > 1e-7
        assert not (reached and seen)
        kinds.add((reached, seen))
    assert len(kinds) == 3
    for one in drawn(RandomPlants(5, 20, n=(4,), conditioning=10.0)):  # what is not asked for is not there
        assert pbh(one.F, one.G) > 1e-7
        assert pbh(one.F.T, one.H.T) > 1e-7


def test_units():
    plain, scaled = (RandomPlants(1, 30, p=(2,), q=(2,), output_decades=d, input_decades=d) for d in (0.0, 3.0))
    outputs, inputs = [], []
    for one, other in zip(drawn(plain), drawn(scaled), strict=True):
        assert np.array_equal(one.F, other.F)
        outputs += [np.log10(np.linalg.norm(other.H, axis=1) / np.linalg.norm(one.H, axis=1))]
        inputs += [np.log10(np.linalg.norm(other.G, axis=0) / np.linalg.norm(one.G, axis=0))]
    for powers in (outputs, inputs):
        assert -3 <= np.min(powers) < -2.5
        assert 2.5 < np.max(powers) <= 3


def test_benchmarks():
    plants = BenchmarkPlants(("ac1", "toy"), (0.1, 0.2))
    found = benchmark("toy")
    assert np.array_equal(plants.draw(3).F, found.sampled(0.2).F)
    assert plants.draw(3).size == (*np.shape(found.A)[:1], len(found.C), found.B.shape[1], found.order(0.2))
    assert plants.draw(3).size[1:] in plants.sizes()
    assert len(BenchmarkPlants()) == 19
    assert BenchmarkPlants().labels()[0] == "ac1"


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"count": 0}, "count must be an integer of at least 1, got 0"),
        ({"n": ()}, "n must have at least one size, got none"),
        ({"p": (1, 1)}, "p must have each size once, got"),
        ({"q": (0,)}, "q must be an integer of at least 1, got 0"),
        ({"hidden": 4}, "hidden must be below the least n, 4, got 4"),
        ({"radius": (1.2, 0.5)}, "radius must be two numbers, positive and in ascending order, got"),
        ({"radius": (0.0, 0.5)}, "radius must be two numbers, positive"),
        ({"growth": (0.0, float("nan")), "sampling": (0.1,)}, "growth must be two numbers, in ascending order, got"),
        ({"growth": (0.0, 1.0)}, "sampling must be given with growth and left out without, got one"),
        ({"sampling": (0.1,)}, "sampling must be given with growth and left out without, got one"),
        ({"sampling": (0.0,)}, "sampling must be a positive finite number, got 0.0"),
        ({"conditioning": 0.5}, "conditioning must be a number of at least 1, got 0.5"),
        ({"output_decades": -1.0}, "output_decades must be a number of at least 0, got -1.0"),
        ({"seed": -1}, "seed must be an integer of at least 0, got -1"),
    ],
)
def test_refused(settings, sentence):
    with pytest.raises(InputError, match=sentence):
        RandomPlants(**{"seed": 1, "count": 1} | settings)


def test_plants_that_are_not_there():
    for plants in (RandomPlants(1, 2), BenchmarkPlants(("toy",))):
        with pytest.raises(InputError, match="i must be from 0 to"):
            plants.draw(len(plants))
    with pytest.raises(InputError, match="benchmark must be one of ac3, "):
        BenchmarkPlants(("ac33",))
    fast = RandomPlants(1, 1, growth=(1e3, 1e3), sampling=(10.0,))
    with pytest.raises(InputError, match="sampling must be short enough to keep the state in"):
        fast.draw(0)


def test_a_benchmark_plant_has_the_same_errors_at_every_sampling_time():
    both = BenchmarkPlants(("toy", "ac1"), sampling=(0.1, 0.2))
    toy, slower, other = (both.errors(i).generate_state(4).tolist() for i in range(3))
    assert toy == slower != other
    assert toy == BenchmarkPlants(("toy",)).errors(0).generate_state(4).tolist()
    assert BenchmarkPlants(("toy",)).labels() == ["toy"]
    assert BenchmarkPlants().sampling == (0.1,)
