"""The simulations' claims as recorded; the exact tests on equation (23) against python-control."""

from dataclasses import replace

import control
import numpy as np
import pytest

from rhl.paper import published
from rhl.paper.claims import simulations
from rhl.paper.claims.claim import Effort, judge
from rhl.paper.published import linear_example
from rhl.plants import LinearPlant
from tests.evidence import EFFORT, drift


@pytest.mark.parametrize("claim", simulations.CLAIMS, ids=lambda claim: claim.id)
def test_as_recorded(claim):
    judgement = judge(claim, EFFORT)
    assert judgement.as_recorded, judgement
    assert drift(judgement, EFFORT) == ""


def test_exact_matrices_are_those_of_the_example(monkeypatch):
    plant = linear_example().plant
    for exact, M in zip(simulations.linear_matrices(), (plant.F, plant.G, plant.H), strict=True):
        assert np.array_equal(np.array(exact, dtype=float), M)
    other = replace(linear_example(), plant=LinearPlant(plant.F + 1e-3, plant.G, plant.H))
    monkeypatch.setattr(published, "linear_example", lambda: other)
    with pytest.raises(ValueError, match="must be hundredths"):
        simulations.linear_matrices()


def test_ranks_agree_with_python_control():
    plant = linear_example().plant
    assert np.linalg.matrix_rank(control.obsv(plant.F, plant.H)) == 3
    assert np.linalg.matrix_rank(control.ctrb(plant.F, plant.G)) == 2


def test_modes_that_are_none_are_no_evidence():
    assert not simulations.check_linear_rank(Effort(), "input", ("1/3",)).passes
