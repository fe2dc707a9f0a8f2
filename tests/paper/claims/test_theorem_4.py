"""Theorem 4: claims as recorded, and that their quantities mean what they say."""

import numpy as np
import pytest

from rhl.controllability import controllability_matrix
from rhl.family import ModelFamily
from rhl.lifting import DelayLifting
from rhl.model import SignalModel
from rhl.paper.claims import theorem_4, theorem_4_grid
from rhl.paper.claims.claim import Effort, judge
from tests.evidence import drift
from tests.sizes import SEEDS


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("claim", theorem_4.CLAIMS, ids=lambda claim: claim.id)
def test_as_recorded(claim, seed):
    judgement = judge(claim, effort := Effort(seed, 10))
    assert judgement.as_recorded, judgement
    assert drift(judgement, effort) == ""


def test_polynomials_are_bounded_by_their_values_on_the_grid():
    """Interpolation on the grid of order two: the determinant at any point follows from those of the members."""
    rng = np.random.default_rng(0)
    shifts = ModelFamily.grid(1, 2, 1, 2).shifts[:, 0]
    wanted = theorem_4_grid.determined(1, 1, 2)
    V = np.array([[np.prod(point**e) for e in wanted] for point in shifts])
    lifting, initial = DelayLifting(2, 2), SignalModel.shift_of_ones(1, 2, 1, 2)

    def determinant(G):
        A, B = np.array(initial.A), np.array(initial.B)
        A[0] += G[:2]
        B[0] += G[2:]
        return np.linalg.det(controllability_matrix(lifting.augment(SignalModel(A, B))))

    values = np.array([determinant(point) for point in shifts])
    for hidden in rng.normal(size=(5, 4)):
        weights = np.linalg.solve(V.T, [np.prod(hidden**e) for e in wanted])
        assert weights @ values == pytest.approx(determinant(hidden), abs=1e-9 * np.sum(np.abs(weights)))
        assert np.max(np.abs(values)) >= abs(determinant(hidden)) / np.sum(np.abs(weights)) - 1e-12


def test_the_member_is_changed_a_few_times_only():
    for trace in theorem_4.runs(SEEDS[-1], 10):
        assert trace is not None
        family, memory = trace.scheme.family, trace.scheme.estimator
        at = [int(family.nearest(done.model, done.estimate, memory.spread(done.data))) for done in trace.steps]
        assert len(set(at[-50:])) == 1
        assert np.sum(np.diff(at) != 0) < 20


def test_without_data_no_grid_of_fewer_members_will_do():
    assert not theorem_4_grid.check_grid(Effort(), drop=True).passes
