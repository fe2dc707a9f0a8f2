"""A loss that varies: the frozen error against its product, the bounds, slow fading, the ledger's lines."""

from fractions import Fraction

import numpy as np
import pytest

from rhl.losses import Varying, WeightedSquares
from rhl.model import SignalModel
from rhl.paper.claims import varying_loss
from rhl.paper.claims.claim import Effort, judge
from rhl.paper.claims.estimation import estimate
from rhl.paper.claims.varying_loss import CLAIMS
from tests.evidence import drift
from tests.sizes import SEEDS


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("claim", CLAIMS, ids=lambda claim: claim.id)
def test_claim_comes_out_as_recorded(claim, seed):
    judgement = judge(claim, effort := Effort(seed, 10))
    assert judgement.as_recorded, judgement
    assert drift(judgement, effort) == ""


def test_frozen_error_is_the_infinite_product():
    low, high = varying_loss.frozen_error(Fraction(1, 2), 50)
    assert 0 < high - low < Fraction(1, 10**14)
    assert float(low) == pytest.approx(np.prod(1 / (1 + 0.5 ** np.arange(1, 60))), rel=1e-12)
    assert float(low) == pytest.approx(0.4194, abs=5e-5)
    assert varying_loss.frozen_error(Fraction(1), 5) == (0, Fraction(1, 32))


def test_an_enclosure_that_cannot_tell_is_no_evidence(monkeypatch):
    monkeypatch.setattr(varying_loss, "frozen_error", lambda ratio, steps: (Fraction(0), Fraction(1)))
    assert not varying_loss.check_fading(Effort()).conclusive


def test_a_library_that_ignores_the_step_is_noticed(monkeypatch):
    """The loss of step zero at every step: that is another run, in which the error goes to zero."""
    monkeypatch.setattr(Varying, "loss", lambda self, k: self.at(0))
    assert varying_loss.check_fading(Effort()).worst > 0.4


def test_any_weights_that_come_near_zero_can_be_frozen():
    """c = e^2 / k: the weights have no finite sum, but data that come at k = 1, 2, 4, 8, ... meet some that do."""
    steps = 2**12
    u = np.zeros((steps, 1))
    u[2 ** np.arange(13) - 1] = 1.0  # u(k-1) counts at step k
    loss = Varying(lambda k: WeightedSquares(1 / k))
    start = SignalModel(np.zeros((1, 1)), np.ones((1, 1)))
    record = estimate(np.zeros((steps + 1, 1)), u, start, 1, np.zeros(steps), loss=loss)
    expected = np.prod(1 / (1 + 0.5 ** np.arange(13)))
    assert record.models[-1].B[0, 0] == pytest.approx(expected, rel=1e-9)
    assert record.misfits()[2 ** np.arange(13) - 1].min() > 0.2
