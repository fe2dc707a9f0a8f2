"""Faults that checks once let pass: the library or what a claim is about is changed, and its claim must not hold."""

from dataclasses import replace

import numpy as np
import pytest

from rhl import horizon, simulation
from rhl.errors import InfeasibleError
from rhl.horizon import Plan
from rhl.model import PredictorMaps
from rhl.paper import published
from rhl.paper.claims import (
    assumption_4,
    lemma_1,
    lemma_2,
    lemma_2_proof,
    lemma_3,
    lyapunov_terms,
    remark_1,
    simulations,
)
from rhl.paper.claims.claim import Effort, judge
from rhl.problems import V2, V3


def claim(id):
    modules = (assumption_4, remark_1, lemma_1, lemma_2, lemma_2_proof, lemma_3, simulations)
    return next(each for module in modules for each in module.CLAIMS if each.id == id)


@pytest.fixture(autouse=True)
def fresh_runs():
    """Runs are kept from one check to the next; those of a changed library must not be."""
    lemma_2_proof.sample.cache_clear()
    simulations._run.cache_clear()
    yield
    lemma_2_proof.sample.cache_clear()
    simulations._run.cache_clear()


def other_values(patch):
    """Values of V3 that are twice what they are: their increments still add up."""
    right = Plan.value.fget
    patch.setattr(Plan, "value", property(lambda plan: right(plan) * (2 if isinstance(plan.problem, V3) else 1)))


def unit_weights(patch):
    """A proof for Q = R = I, whatever the weights are."""
    right = lyapunov_terms.solve
    patch.setattr(lyapunov_terms, "solve", lambda problem, x: right(replace(problem, Q=1.0, R=1.0), x))


def full_rank_only(patch):
    """A solver that needs all of the terminal state within the inputs' reach."""
    right = horizon.truncated_min_norm

    def demanding(steering, wanted, sizes):
        if np.any(np.linalg.matrix_rank(steering, tol=1e-9) < steering.shape[-2]):
            raise InfeasibleError("out of reach")
        return right(steering, wanted, sizes)

    patch.setattr(horizon, "truncated_min_norm", demanding)


def deaf_maps(patch):
    """Predictor maps that leave out the inputs."""
    right = PredictorMaps.predict
    patch.setattr(PredictorMaps, "predict", lambda maps, x, u: right(maps, x, 0 * np.asarray(u)))


def unit_terminal_weight(patch):
    """A V2 that forgets its weight."""
    right = lemma_1.solve
    patch.setattr(
        lemma_1,
        "solve",
        lambda problem, x: right(replace(problem, QN=1.0) if isinstance(problem, V2) else problem, x),
    )


def one_map_for_all_steps(patch):
    """A V2 that moves all inputs through B_0."""
    right = assumption_4.solve

    def solve(problem, x):
        plan = right(problem, x)
        if isinstance(problem, V2) and isinstance(problem.model, PredictorMaps):
            first = PredictorMaps(problem.model.A, np.repeat(problem.model.B[:1], problem.horizon, axis=0))
            u = right(replace(problem, model=first), x).u
            return Plan(problem, u, problem.model.predict(x, u))
        return plan

    patch.setattr(assumption_4, "solve", solve)


def rho_without_c(patch):
    """Lemma 3's constant for c = 1, whatever c is."""
    right = lemma_3.rho
    patch.setattr(lemma_3, "rho", lambda Q, R, c: right(Q, R, 1.0))


def changed_curve(name, k, by):
    def change(patch):
        right = published.curve

        def curve(asked):
            samples = right(asked).copy()
            if asked == name:
                samples[k] += by
            return samples

        patch.setattr(published, "curve", curve)

    return change


def ends_at_zero(patch):
    """A run that oscillates for ever, and is at zero in its last step."""
    right = simulation.simulate

    class Swinging:
        z = np.cos(np.pi / 2 * np.arange(300))[:, None]

    assert abs(Swinging.z[-1, 0]) < 1e-9
    patch.setattr(simulations, "simulate", lambda *arguments: Swinging if arguments[-1] == 300 else right(*arguments))


@pytest.mark.parametrize(
    ("id", "mutate"),
    [
        ("eq-25", other_values),
        ("eq-31", other_values),
        ("eq-25", unit_weights),
        ("lemma-2", full_rank_only),
        ("eq-38", full_rank_only),
        ("lemma-1.a", full_rank_only),
        ("lemma-1.a.value", full_rank_only),
        ("lemma-1.b", unit_terminal_weight),
        ("assumption-4b", deaf_maps),
        ("assumption-4c", one_map_for_all_steps),
        ("remark-1.bounded", deaf_maps),
        ("lemma-3", rho_without_c),
        ("eq-39", rho_without_c),
        ("eq-23", changed_curve("linear_x1", 30, 1e-3)),
        ("eq-23", changed_curve("linear_y", 40, 1e-3)),
        ("eq-24", changed_curve("robot_x1", 61, 1e-3)),
        ("figure-2", changed_curve("linear_y", 25, 1e-3)),
        ("figure-2", changed_curve("linear_y_hat", 25, 1e-3)),
        ("figure-4", changed_curve("linear_u", 35, 1e-3)),
        ("figure-5", changed_curve("linear_x1", 41, 1e-3)),
        ("figure-4.unexplained", changed_curve("linear_u", 20, 1e-3)),
        ("text-linear-converges", ends_at_zero),
    ],
    ids=lambda value: value if isinstance(value, str) else value.__name__,
)
def test_what_passed_is_caught(monkeypatch, id, mutate):
    assert judge(claim(id), Effort(0, 40)).as_recorded
    mutate(monkeypatch)
    fresh = claim(id)
    lemma_2_proof.sample.cache_clear()
    simulations._run.cache_clear()
    assert judge(fresh, Effort(0, 40)).verdict != fresh.recorded


@pytest.mark.parametrize("name", ["F", "G", "H"])
def test_every_entry_of_the_linear_plant_shows_in_the_published_curves(name):
    matrix = getattr(published.linear_example().plant, name)
    for row in range(matrix.shape[0]):
        for column in range(matrix.shape[1]):
            found = simulations.check_linear_plant(Effort(), (name, row, column), 1e-3)
            assert found.worst > 1e-6
            assert not found.passes
