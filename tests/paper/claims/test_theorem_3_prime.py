"""Theorem 3': claims as recorded, and that their quantities mean what they say."""

import numpy as np
import pytest

from rhl.paper.claims import theorem_3_prime
from rhl.paper.claims.claim import Effort, judge
from tests.evidence import drift
from tests.sizes import SEEDS


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("claim", theorem_3_prime.CLAIMS, ids=lambda claim: claim.id)
def test_as_recorded(claim, seed):
    judgement = judge(claim, effort := Effort(seed, 10))
    assert judgement.as_recorded, judgement
    assert drift(judgement, effort) == ""


def test_most_runs_are_runs_of_the_theorem():
    """The hypothesis is not empty: the margin stays above delta in three of four runs."""
    counted = np.concatenate([theorem_3_prime.of_the_theorem(trace) for trace, _ in theorem_3_prime.runs(0, 100)])
    assert np.mean(counted) > 0.75


def test_the_pairs_are_those_of_the_plants():
    for trace, truths in theorem_3_prime.runs(0, 10):
        x, u = trace.lifted
        first = trace.scheme.first_measured
        for i, truth in enumerate(truths):
            said = x[first:-1, i] @ truth.A.T + u[first + 1 :, i] @ truth.B.T
            assert np.max(np.abs(said - x[first + 1 :, i])) < 1e-8 * np.max(np.abs(x[:, i]))


def test_a_loop_that_peaks_from_small_states_alone_is_noticed(monkeypatch):
    """Each size is compared with the one before, not with the first."""
    monkeypatch.setattr(theorem_3_prime, "largest_states", lambda *given: np.array([[1.0], [0.5], [0.48]]))
    evidence = theorem_3_prime.check_stability(Effort(0, 10))
    assert (evidence.worst, evidence.passes) == (pytest.approx(0.96), False)


def test_the_scalar_loop_with_a_small_state_peaks_where_the_weight_holds_it():
    tops = theorem_3_prime.largest_states(lambda k: 1.0, np.array([1e-6]))
    assert tops[0] == pytest.approx(np.sqrt(100 * (np.array([1.1, 1.3, 1.7]) - 1)), rel=0.3)
