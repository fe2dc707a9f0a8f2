"""Scores tell apart what comes to rest, what creeps and what runs away, and have no unit."""

from dataclasses import astuple

import numpy as np
import pytest

from rhl import InputError, LinearPlant
from rhl.study.compare import compare

PLANT = LinearPlant([[1.1, 1.0], [0.0, 0.9]], [[0.0], [1.0]], [[1.0, 0.0]])
Z0 = np.array([1.0, -1.0])


def by_method(scores):
    return {score.method: score for score in scores}


def test_a_plant_that_all_bring_to_rest():
    scores = by_method(compare(PLANT, Z0, 2, 80))
    assert list(scores) == ["the plant known", "excite, identify, regulate", "window_scheme", "default_scheme"]
    assert all(score.at_rest for score in scores.values())
    assert scores["the plant known"].cost == 1.0
    assert all(score.cost > 1.0 for name, score in scores.items() if name != "the plant known")
    assert all(score.settled_at is not None for score in scores.values())
    assert all(score.peak >= 1.0 for score in scores.values())


def test_what_no_input_reaches_is_not_at_rest():
    deaf = LinearPlant([[1.2, 0.0], [0.0, 0.5]], [[0.0], [1.0]], [[1.0, 1.0]])
    for score in compare(deaf, [1.0, 0.5], 2, 60):
        assert not score.at_rest
        assert score.settled_at is None


def test_a_run_that_diverges_is_infinite():
    scores = by_method(compare(LinearPlant([[1e9]], [[1e-12]], [[1.0]]), [1.0], 1, 60))
    lost = scores["window_scheme"]
    assert (lost.at_rest, lost.peak, lost.cost, lost.settled_at) == (False, np.inf, np.inf, None)


def test_scores_of_the_default_scheme_have_no_unit():
    other = LinearPlant(PLANT.F, PLANT.G, 1e3 * PLANT.H)
    one, two = (by_method(compare(of, Z0, 2, 60)) for of in (PLANT, other))
    free = "default_scheme"
    assert np.allclose(astuple(one[free])[2:5], astuple(two[free])[2:5], rtol=1e-6)
    assert not np.isclose(one["window_scheme"].cost, two["window_scheme"].cost, rtol=1e-2)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"z0": [1.0]}, "z0 must have shape"),
        ({"z0": [0.0, 1.0]}, r"y\(0\) must not be zero"),
        ({"z0": [1e-180, 0.0]}, r"y\(0\) must not be zero, and lie between 1e-100 and 1e100, .* got 1e-180"),
        ({"seed": -1}, "seed must be an integer of at least 0, got -1"),
        ({"order": 0}, "order must be an integer"),
        ({"steps": 5}, "steps must be an integer of at least 20"),
        ({"plant": 1}, "plant must be a LinearPlant"),
        ({"z0": [[1.0, 1.0]]}, "plant and z0 must be of one run"),
    ],
)
def test_refused(changes, sentence):
    with pytest.raises(InputError, match=sentence):
        compare(**{"plant": PLANT, "z0": Z0, "order": 2} | changes)
