"""Scores tell apart what comes to rest, what creeps and what runs away, and have no unit."""

from dataclasses import astuple

import numpy as np
import pytest

from rhl import InputError, LinearPlant
from rhl.paper.published import linear_example
from rhl.study import compare as module
from rhl.study.compare import METHODS, Score, compare, our_scheme, paper_scheme, summaries

PLANT = LinearPlant([[1.1, 1.0], [0.0, 0.9]], [[0.0], [1.0]], [[1.0, 0.0]])
Z0 = np.array([1.0, -1.0])


def by_method(scores):
    return {score.method: score for score in scores}


def test_a_plant_that_all_bring_to_rest():
    scores = by_method(compare(PLANT, Z0, 2, 120))
    assert tuple(scores) == METHODS
    # Another rival need not bring this plant to rest.
    own = ("known-plant", "excite-identify", "adaptive-lq", "deepc", "paper", "window_scheme", "default_scheme")
    scores = {name: scores[name] for name in own}
    # The dither of adaptive-lq does not end.
    assert all(score.at_rest for name, score in scores.items() if name != "adaptive-lq")
    assert np.isfinite(scores["adaptive-lq"].cost)
    assert scores["known-plant"].cost == 1.0
    assert all(score.cost > 1.0 for name, score in scores.items() if name != "known-plant")
    assert all(score.settled_at is not None for name, score in scores.items() if name != "adaptive-lq")
    assert all(score.peak >= 1.0 for score in scores.values())
    assert all(score.step_time > 0 for score in scores.values())
    assert not any(score.failure for score in scores.values())


def test_scores_do_not_depend_on_the_sign():
    plant = LinearPlant([[1.1, 1.0], [0.0, 0.9]], [[0.0], [1.0]], [[1.0, 0.0]])
    (one,), (other,) = (compare(plant, [sign, sign], 2, methods=["known-plant"]) for sign in (1.0, -1.0))
    assert (one.at_rest, one.settled_at) == (other.at_rest, other.settled_at)
    assert one.peak == pytest.approx(other.peak)
    assert one.peak >= 1


def test_what_no_input_reaches_is_not_at_rest():
    deaf = LinearPlant([[1.2, 0.0], [0.0, 0.5]], [[0.0], [1.0]], [[1.0, 1.0]])
    for score in compare(deaf, [1.0, 0.5], 2, 120):
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
        ({"z0": [0.0, 1.0]}, r"y\(0\) must be nonzero"),
        ({"z0": [1e-180, 0.0]}, r"y\(0\) must be nonzero and between 1e-100 and 1e100, .* got 1e-180"),
        ({"seed": -1}, "seed must be an integer of at least 0, got -1"),
        ({"order": 0}, "order must be an integer"),
        ({"steps": 5}, "steps must be an integer of at least 20"),
        ({"plant": 1}, "plant must be a LinearPlant"),
        ({"z0": [[1.0, 1.0]]}, "plant and z0 must be of one run"),
        ({"seeds": 0}, "seeds must be an integer of at least 1, got 0"),
        ({"methods": ["mpc"]}, "method must be one of known-plant, .*, default_scheme, got 'mpc'"),
        ({"methods": "deepc"}, "methods must be a sequence of names, got the string 'deepc'; put it in a list"),
        ({"noise": 2}, r"noise must be a number in \[0, 1\), got 2"),
    ],
)
def test_refused(changes, sentence):
    with pytest.raises(InputError, match=sentence):
        compare(**{"plant": PLANT, "z0": Z0, "order": 2} | changes)


def test_the_papers_settings_are_the_papers():
    ours, theirs = paper_scheme(1, 1, 4), linear_example().scheme
    assert (ours.lifting, ours.mixing) == (theirs.lifting, theirs.mixing)
    assert ours.estimator.window == theirs.estimator.window
    for name in ("Q", "R", "QN", "horizon", "alpha", "model_delay", "adaptive"):
        assert getattr(ours.controller, name) == getattr(theirs.controller, name)
    assert [ours.controller.epsilon(k) for k in (0, 7)] == [theirs.controller.epsilon(k) for k in (0, 7)]
    assert np.array_equal(ours.initial_model.theta, theirs.initial_model.theta)
    assert ours.estimator.generator.weight == theirs.estimator.generator.weight
    assert (type(ours.estimator.loss), type(ours.estimator.generator)) == (
        type(theirs.estimator.loss),
        type(theirs.estimator.generator),
    )
    # The horizon grows with the augmented state, as the theory asks.
    assert (paper_scheme(2, 1, 4).controller.horizon, paper_scheme(5, 2, 5).controller.horizon) == (20, 33)


def test_what_draws_nothing_runs_once():
    drawn = {"excite-identify", "adaptive-lq", "deepc"}
    for noise, several in ((0.0, drawn), (0.01, set(METHODS) - {"known-plant"})):
        scores = compare(PLANT, Z0, 2, 40, seeds=3, seed=5, noise=noise)
        for method in METHODS:
            seeds = [score.seed for score in scores if score.method == method]
            assert seeds == ([5, 6, 7] if method in several else [5])


def test_a_seed_is_the_same_alone_and_with_others():
    together = compare(PLANT, Z0, 2, 40, seeds=3, noise=0.01, methods=["deepc", "default_scheme", "paper"])
    alone = compare(PLANT, Z0, 2, 40, seed=2, noise=0.01, methods=["deepc", "default_scheme", "paper"])
    for score in alone:
        (same,) = (other for other in together if (other.method, other.seed) == (score.method, 2))
        assert np.isclose(score.cost, same.cost, rtol=1e-9)


def test_outputs_count_as_they_are_and_not_as_measured():
    """With noise of 5 % a plant that is at rest by itself stays so, though measured outputs do not look it."""
    quiet = LinearPlant([[0.1]], [[1.0]], [[1.0]])
    (score,) = compare(quiet, [1.0], 1, 60, noise=0.05, methods=["known-plant"])
    assert score.peak == 1.0
    assert score.settled_at == 1


def test_noise_widens_what_counts_as_rest():
    """An output that ends at 0.1 is at rest with 2 % of noise, and not without."""
    held = LinearPlant([[1.0, 0.0], [0.0, 0.0]], [[0.0], [0.0]], [[1.0, 1.0]])
    exact, noisy = (compare(held, [0.1, 0.9], 2, 60, noise=s, methods=["known-plant"])[0] for s in (0.0, 0.02))
    assert (exact.at_rest, noisy.at_rest) == (False, True)


def test_bounds_hold_for_all():
    (largest,) = (score.largest_input for score in compare(PLANT, Z0, 2, 60, methods=["known-plant"]))
    free, bounded = (compare(PLANT, Z0, 2, 120, bounded=bound) for bound in (None, 0.7))
    assert all(score.largest_input <= 0.7 * largest * (1 + 1e-12) for score in bounded)
    assert any(score.largest_input > 0.7 * largest for score in free)
    assert all(score.bounded == 0.7 for score in bounded)


def test_one_bad_run_does_not_end_the_table(monkeypatch):
    """The run of seed 1 raises; the others have their scores, and its own says what was raised."""
    whole = module._RUN["deepc"]

    def fails(tasks):
        if any(task.seed == 1 for task in tasks):
            raise RuntimeError("no luck")
        return whole(tasks)

    monkeypatch.setitem(module._RUN, "deepc", fails)
    scores = compare(PLANT, Z0, 2, 60, seeds=3, methods=["deepc", "known-plant"])
    assert [score.failure for score in scores] == ["", "RuntimeError: no luck", "", ""]
    assert [score.cost == np.inf for score in scores] == [False, True, False, False]
    monkeypatch.undo()
    assert not any(score.failure for score in compare(PLANT, Z0, 2, 60, seeds=3, methods=["deepc"]))


def test_an_interrupt_is_let_through(monkeypatch):
    def stopped(tasks):
        raise KeyboardInterrupt

    monkeypatch.setitem(module._RUN, "deepc", stopped)
    with pytest.raises(KeyboardInterrupt):
        compare(PLANT, Z0, 2, 60, methods=["deepc"])


def test_our_scheme_is_the_default():
    scheme = our_scheme(2, 1, 3, np.array([1.0]), np.array([0.1, 0.2]))
    assert (scheme.p, scheme.q, scheme.lifting.outputs) == (2, 1, 3)


def test_a_scheme_can_be_told_bounds_and_noise(monkeypatch):
    """What stands in the place of our scheme is given both, in the plant's own units."""
    told = []
    monkeypatch.setitem(
        module._SCHEMES, "default_scheme", lambda *given: told.append(given) or paper_scheme(*given[:3])
    )
    compare(PLANT, 2.0 * Z0, 2, 40, noise=0.01, bounded=3.0, methods=["default_scheme"])
    compare(PLANT, 2.0 * Z0, 2, 40, methods=["default_scheme"])
    (p, q, order, bound, noise), (*_, free, exact) = told
    assert (p, q, order, free) == (1, 1, 2, None)
    assert bound.shape == (1,)
    assert np.allclose(noise, 0.02)
    assert not np.any(exact)


def test_summaries_count():
    def score(method, rest, peak):
        return Score(method, rest, peak, peak**2, 1.0, None)

    first, second = summaries(
        [
            score("deepc", True, 2.0),
            score("paper", False, np.inf),
            score("deepc", True, 200.0),
            score("deepc", False, 5.0),
        ]
    )
    assert (first.method, first.runs, first.at_rest, first.low_peak, first.peak, first.cost) == (
        "deepc",
        3,
        2,
        1,
        5.0,
        25.0,
    )
    assert (second.method, second.runs, second.at_rest, second.peak) == ("paper", 1, 0, np.inf)
