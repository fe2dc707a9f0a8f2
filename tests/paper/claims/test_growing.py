"""Growing memory: against the window, against forgetting, on the spiral's data and in a loop, the ledger's lines."""

import numpy as np
import pytest

from rhl.losses import WeightedSquares
from rhl.memory import GrowingMemory
from rhl.model import SignalModel
from rhl.paper.claims import growing
from rhl.paper.claims.claim import Effort, judge
from rhl.paper.claims.estimation import draw_model, estimate, spiral_estimates, trajectory
from rhl.paper.claims.proximal import Squares
from tests.evidence import drift
from tests.sizes import SEEDS

CLAIMS = (*growing.LEMMA, *growing.THEOREM)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("claim", CLAIMS, ids=lambda claim: claim.id)
def test_claim_comes_out_as_recorded(claim, seed):
    judgement = judge(claim, effort := Effort(seed, 10))
    assert judgement.as_recorded, judgement
    assert drift(judgement, effort) == ""


def test_one_step_on_a_sum_has_its_closed_form():
    rows, aims = np.array([[1.0, 0.0], [1.0, 1.0]]), np.array([1.0, 3.0])
    minimisers, centres = growing.iterate_sums(
        rows, aims, WeightedSquares, Squares(), np.zeros(2), np.array([0.0, 0.5]), growing.keep_all
    )
    np.testing.assert_allclose(minimisers[0], [0.5, 0.0])
    expected = np.linalg.solve(np.eye(2) + rows.T @ rows, [0.5, 0.0] + rows.T @ aims)
    np.testing.assert_allclose(minimisers[1], expected)
    np.testing.assert_allclose(centres[2], (minimisers[1] + centres[1]) / 2)


def test_what_is_kept():
    assert growing.keep_all(2).tolist() == [1, 1, 1]
    assert growing.keep_latest(3, 2).tolist() == [0, 0, 1, 1]
    assert growing.keep_fading(2).tolist() == [0.25, 0.5, 1]


@pytest.mark.parametrize("keep", [growing.keep_latest, growing.keep_fading])
def test_iterations_that_forget_do_not_arrive(keep):
    assert growing.check_growing(Effort(), keep).worst > 1e-2


def test_memory_is_the_window_of_every_transition():
    rng = np.random.default_rng(0)
    truth, initial, u = draw_model(rng, 2, 1), draw_model(rng, 2, 1), rng.standard_normal((6, 1))
    x = trajectory(truth, np.ones(2), u)
    record = growing.remember(x, u, initial, np.zeros(6))
    window = estimate(x, u, record.models[5], 6, np.zeros(6), first=6)
    np.testing.assert_allclose(record.models[6].theta, window.models[6].theta, rtol=1e-9)


def test_a_memory_that_forgets_everything_is_a_window_of_one():
    spiral = spiral_estimates(100)
    forgetful = growing.spiral_against(100, 0.0)
    for ours, theirs in zip(forgetful.models, spiral.models, strict=True):
        np.testing.assert_allclose(ours.theta, theirs.theta, atol=1e-12)


@pytest.mark.parametrize("against", ["itself", "the window"])
def test_the_spirals_data_bring_the_growing_memory_to_the_truth(against):
    """The inputs stand at a right angle to the memory's own estimate, or to that of the window that they mislead."""
    if against == "itself":
        last = growing.spiral_against(500).models[-1]
    else:
        spiral = spiral_estimates(500)
        last = growing.remember(spiral.x, spiral.u, spiral.models[0], np.zeros(500)).models[-1]
        assert np.abs(spiral.models[-1].B).max() > 0.5
    assert np.abs(last.B).max() < 1e-12


def test_loop_of_the_linear_example():
    """Relative to the largest signal, and as the largest entry of what is missed."""
    memory, window = growing.example_run(160, True), growing.example_run(160, False)
    assert growing.missed(memory) < 1e-14
    assert growing.missed(window) > 1e-5
    left = [np.abs(growing.all_residuals(of, of.models[-1])).max() for of in (memory, window)]
    assert left[0] < 1e-12
    assert left[1] == pytest.approx(6.9e-3, rel=0.01)
    assert np.abs(memory.u).max() == pytest.approx(17.2, abs=0.05)
    assert np.abs(window.u).max() == pytest.approx(73.2, abs=0.05)


def test_a_memory_that_forgets_inside_the_library_is_noticed(monkeypatch):
    """The library's own estimator is what is checked."""
    remember = GrowingMemory.remember
    monkeypatch.setattr(GrowingMemory, "remember", lambda self, data, x, u: remember(self, 0.9 * data, x, u))
    assert not growing.check_estimator(Effort(0, 10)).passes


def test_a_memory_that_is_not_held_to_the_model_before_is_noticed(monkeypatch):
    """Least squares from nothing, every time, fits as well; but it does not obey Lemma 4's bound."""
    minimise = GrowingMemory.minimise
    far = lambda centre: SignalModel(centre.A + 1.0, centre.B)  # noqa: E731
    monkeypatch.setattr(
        GrowingMemory, "minimise", lambda self, centre, data, size=None: minimise(self, far(centre), data, size)
    )
    assert not growing.check_estimator(Effort(0, 10)).passes
