"""The simulations' claims as recorded; the exact tests on equation (23) against python-control."""

import control
import numpy as np
import pytest

from rhl.paper.claims import simulations
from rhl.paper.claims.claim import Effort, judge
from rhl.paper.published import linear_example


@pytest.mark.parametrize("claim", simulations.CLAIMS, ids=lambda claim: claim.id)
def test_as_recorded(claim):
    judgement = judge(claim, Effort(0, 10))
    assert judgement.as_recorded, judgement


def test_exact_matrices_are_those_of_the_example():
    plant = linear_example().plant
    assert np.array_equal(np.array(simulations._F) / 100, plant.F)
    assert np.array_equal(simulations._G, plant.G)
    assert np.array_equal(simulations._H, plant.H)


def test_ranks_agree_with_python_control():
    plant = linear_example().plant
    assert np.linalg.matrix_rank(control.obsv(plant.F, plant.H)) == 3
    assert np.linalg.matrix_rank(control.ctrb(plant.F, plant.G)) == 2


def test_modes_that_are_none_are_no_evidence():
    assert not simulations.check_linear_rank(Effort(), "input", ("1/3",)).passes
