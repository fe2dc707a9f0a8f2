"""Theorem 2(iii): exact augmentation, models that are exact on data, chains of mixtures, the ledger's lines."""

import numpy as np
import pytest
import sympy as sp

from rhl.controllability import LambdaSearch, controllability_margin
from rhl.lifting import DelayLifting
from rhl.model import SignalModel
from rhl.paper.claims import theorem_2_iii
from rhl.paper.claims.claim import Effort, judge
from rhl.paper.claims.growing import example_run
from rhl.paper.claims.lemma_5 import is_controllable
from rhl.paper.claims.theorem_2_iii import CLAIMS, augmented_exactly, exact_models, stacks_of_plant, unexcited_model
from rhl.paper.published import linear_example
from tests.evidence import drift
from tests.sizes import SEEDS


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("claim", CLAIMS, ids=lambda claim: claim.id)
def test_claim_comes_out_as_recorded(claim, seed):
    judgement = judge(claim, effort := Effort(seed, 10))
    assert judgement.as_recorded, judgement
    assert drift(judgement, effort) == ""


@pytest.mark.parametrize(("n", "q", "m"), [(1, 1, 1), (2, 1, 3), (3, 2, 2), (1, 2, 4)])
def test_exact_augmentation_is_the_librarys(n, q, m):
    rng = np.random.default_rng(n)
    A, B = rng.integers(-3, 4, (n, n)), rng.integers(-3, 4, (n, m * q))
    exact = augmented_exactly(A, B, q)
    ours = DelayLifting(1, m).augment(SignalModel(A.astype(float), B.astype(float)))
    np.testing.assert_array_equal(np.array(exact[0].tolist(), dtype=float), ours.A)
    np.testing.assert_array_equal(np.array(exact[1].tolist(), dtype=float), ours.B)


def test_stacks_by_hand():
    phi, after = stacks_of_plant([[2]], [[1]], [[1]], 2, [[1], [0], [3]], [[1]])  # y = 1, 3, 6, 15
    assert phi.tolist() == [[3, 1, 0, 1], [6, 3, 3, 0]]
    assert after.tolist() == [[6, 3], [15, 6]]


def test_exact_models_reproduce_their_data():
    rng = np.random.default_rng(0)
    phi, after = stacks_of_plant([[2]], [[1]], [[1]], 2, [[1], [0], [3], [-1], [2]], [[1]])
    models = exact_models(rng, phi, after, 4)
    assert all((after - phi * sp.Matrix.hstack(A, B).T).is_zero_matrix for A, B in models)
    assert len({tuple(A) + tuple(B) for A, B in models}) > 1
    after[0, 0] += 1  # x(k+1) and x(k+2) now disagree, but three more transitions leave no room
    with pytest.raises(ValueError, match="satisfy no signal model"):
        exact_models(rng, phi, after, 1)


def test_margin_of_an_exact_model_without_excitation_may_be_large():
    """Data of rank one, z+ = 1.2 z + v, v = -y, m = 2: the controllability matrix is a permutation."""
    A, B = (np.array(of, dtype=float) for of in unexcited_model())
    y = 0.2 ** np.arange(5)
    for k in range(1, 4):
        x, u = y[[k, k - 1]], -y[[k, k - 1]]
        np.testing.assert_allclose(A @ x + B @ u, y[[k + 1, k]], rtol=1e-12)
    augmented = DelayLifting(2, 2).augment(SignalModel(A, B))
    assert controllability_margin(augmented) == pytest.approx(1.0, abs=1e-15)
    true = DelayLifting(2, 2).augment(SignalModel(*(np.array(of, dtype=float) for of in unexcited_model(True))))
    assert controllability_margin(true) < 1e-15


def test_margin_along_the_linear_example_goes_to_zero():
    """mp = 4 > n = 3, and the data span S x R: the last models have no margin left, the first ones have."""
    record, lifting = example_run(160), linear_example().scheme.lifting
    state = np.hstack([record.x[:-1], record.u])
    # x(k), v(k-1), ..., v(k-3), and v(k): 8 columns, of which the first are 3 + 3 in rank.
    scaled = state / np.linalg.norm(state, axis=1, keepdims=True)
    assert np.linalg.matrix_rank(scaled, tol=1e-6) == 3 + 3 + 1
    margins = [float(controllability_margin(lifting.augment(of))) for of in (record.models[3], record.models[-1])]
    assert margins[1] < 1e-13 < 1e-4 * margins[0]


def test_a_search_that_takes_any_candidate_is_noticed(monkeypatch):
    monkeypatch.setattr(LambdaSearch, "choose", lambda self, estimate, previous, augment: np.zeros(()))
    assert not theorem_2_iii.check_kept(Effort(0, 10)).passes
    assert not theorem_2_iii.check_step_to_augmented(Effort(0, 10), on="augmented").passes


def test_the_counterexample_by_hand():
    assert is_controllable([[3]], [[2, -6]])
    assert not is_controllable(*augmented_exactly([[3]], [[2, -6]], 1))
    assert is_controllable(*augmented_exactly([[3]], [[2, 6]], 1))
