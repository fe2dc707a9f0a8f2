"""Enclosed runs against exact fractions, extended precision and float64; and what too few bits leave."""

import csv
import math
import sys
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import flint
import mpmath
import numpy as np
import pytest

import rhl.paper
from rhl.app.cli import main
from rhl.disturbances import Saturation
from rhl.errors import InputError
from rhl.lifting import DelayLifting
from rhl.losses import WeightedSquares
from rhl.model import SignalModel
from rhl.paper import certified, certified_samples, published
from rhl.paper.certified import ball, decimal, enclose, linear_recipe, recipe_of, robot_recipe, whole_line
from rhl.paper.certified_samples import beside_published, bounds, digits, errors_of, signals, unlike
from rhl.paper.claims.certified import (
    FIRST_MISSED,
    TOO_FEW_LINEAR,
    TOO_FEW_ROBOT,
    linear_run,
    robot_run,
)
from rhl.plants import FunctionPlant
from rhl.plants.robot_arm import _ARM_COEFFICIENTS
from rhl.schedules import PowerDecay
from rhl.tracking import SetPoint
from tests import oracle

RECIPES = {"linear": (linear_recipe, published.linear_example), "robot": (robot_recipe, published.robot_arm)}


@pytest.mark.parametrize("printed", [False, True])
@pytest.mark.parametrize("example", RECIPES)
def test_recipe_means_the_settings_of_the_experiment(example, printed):
    make, experiment = (of(printed=printed) for of in RECIPES[example])
    model, controller = experiment.scheme.initial_model, experiment.scheme.controller
    np.testing.assert_array_equal(np.array(make.theta, dtype=float), np.hstack([model.A, model.B]))
    np.testing.assert_array_equal([float(z) for z in make.z0], experiment.z0)
    assert [float(w) for w in (make.Q, make.R, make.QN)] == [controller.Q, controller.R, controller.QN]
    assert (make.horizon, make.window, make.steps) == (
        controller.horizon,
        experiment.scheme.estimator.window,
        experiment.steps,
    )
    assert [float(1 / (1 + make.rate * k)) for k in range(9)] == [controller.epsilon(k) for k in range(9)]
    assert make.mixing == (Fraction(1, 2) if example == "robot" else 0)


def test_plants_are_those_of_the_experiments():
    plant, exact = published.linear_example().plant, linear_recipe().plant
    for ours, theirs in ((exact.F, plant.F), (exact.H, plant.H), (exact.G, plant.G[:, 0])):
        np.testing.assert_array_equal(np.array(ours, dtype=float), theirs)
    assert {name: tuple(map(float, row)) for name, row in certified.ARM.items()} == _ARM_COEFFICIENTS


def test_only_recipes_of_this_kind_are_taken():
    experiment = published.linear_example()
    controller = replace(experiment.scheme.controller, epsilon=PowerDecay(100, 2.0))
    with pytest.raises(InputError, match="must be one of the paper's experiments"):
        recipe_of(replace(experiment, scheme=replace(experiment.scheme, controller=controller)))


def test_published_digits_are_taken_as_they_are_printed():
    for name in published.CURVES:
        with (Path(rhl.paper.__file__).parent / "data" / f"{name}.csv").open(encoding="utf-8") as file:
            printed = [Fraction(row[1]) for row in list(csv.reader(file))[1:]]
        assert [decimal(value) for value in published.curve(name)] == printed


def rational(number):
    return flint.fmpq(number.numerator, number.denominator)


def rationals(rows):
    return flint.fmpq_mat([[rational(Fraction(entry)) for entry in row] for row in rows])


def scaled_eye(n, scale):
    return flint.fmpq_mat([[scale if i == j else flint.fmpq(0) for j in range(n)] for i in range(n)])


def exact_first_inputs(count):
    """The first inputs of the linear example in fractions, with the normal equations of the parameters."""
    recipe, zero, one = linear_recipe(), flint.fmpq(0), flint.fmpq(1)
    F, G, H = (rationals(of) for of in (recipe.plant.F, [[g] for g in recipe.plant.G], recipe.plant.H))
    theta, z = rationals(recipe.theta), rationals([[value] for value in recipe.z0])
    y, v, inputs = [zero] * 20, [zero] * 20, []
    for k in range(count):
        y, used = [(H * z)[0, 0], *y], theta.tolist()
        if k:
            R = flint.fmpq_mat([y[j + 1 : j + 5] + v[j : j + 4] for j in range(8)])
            S = flint.fmpq_mat([y[j : j + 4] for j in range(8)])
            missed = S - R * theta.transpose()
            theta = theta + (R.transpose() * R + scaled_eye(8, one)).solve(R.transpose() * missed).transpose()
        rows = [row[:4] + row[5:] for row in used] + [[zero] * 7, [zero] * 4 + [one, zero, zero]]
        A = flint.fmpq_mat([*rows, [zero] * 5 + [one, zero]])
        B = flint.fmpq_mat([[row[4]] for row in used] + [[one], [zero], [zero]])
        X = flint.fmpq_mat([[entry] for entry in y[:4] + v[:3]])
        P = scaled_eye(7, (X.transpose() * X)[0, 0] * (1 + 100 * k) * 100)
        for _ in range(20):
            K = (B.transpose() * P * A) * (1 / (10000 + (B.transpose() * P * B)[0, 0]))
            P = scaled_eye(7, flint.fmpq(100)) + A.transpose() * P * (A - B * K)
        inputs.append(-(K * X)[0, 0])
        z, v = F * z + G * inputs[-1], [inputs[-1], *v]
    return inputs


def test_enclosures_hold_the_exact_inputs():
    run = linear_run()
    with flint.ctx.workprec(run.bits):
        for k, exact in enumerate(exact_first_inputs(3)):
            assert run.u[k].contains(exact)
            assert not run.u[k].contains(exact + flint.fmpq(1, 10**800))
            assert digits(run.u[k]) > 800


def extended(example):
    """Outputs and inputs of an example in eighty digits, by the oracle's formulas."""
    recipe, experiment = (of() for of in RECIPES[example])
    scheme, real = experiment.scheme, oracle.exact
    quotient = np.frompyfunc(lambda f: mpmath.mpf(f.numerator) / f.denominator, 1, 1)
    theta, z = quotient(np.array(recipe.theta, dtype=object)), quotient(np.array(recipe.z0, dtype=object))
    n, p = len(theta), scheme.p
    y, v, outputs, inputs = [[mpmath.mpf(0)] * p] * 30, [mpmath.mpf(0)] * 30, [], []
    for k in range(recipe.steps):
        now = [z[0] + z[2]] if example == "linear" else list(z)
        y, used = [now, *y], theta

        def stack(age, y=y):
            return [entry for row in y[age : age + recipe.outputs] for entry in row]

        if k:
            R = np.array([stack(j + 1) + v[j : j + recipe.inputs] for j in range(recipe.window)], dtype=object)
            S = np.array([stack(j) for j in range(recipe.window)], dtype=object)
            found = theta + oracle.solve(R.T @ R + real(np.eye(R.shape[1])), R.T @ (S - R @ theta.T)).T
            theta = found + (theta - found) * mpmath.mpf(float(recipe.mixing))
        past = recipe.inputs - 1
        A, B = real(np.zeros((n + past, n + past))), real(np.zeros((n + past, 1)))
        A[:n, :n], A[:n, n:], B[:n, 0], B[n, 0] = used[:, :n], used[:, n + 1 :], used[:, n], 1
        for j in range(past - 1):
            A[n + 1 + j, n + j] = mpmath.mpf(1)
        X = np.array(stack(0) + v[:past], dtype=object)
        unit, weight = real(np.eye(n + past)), X @ X * (1 + int(recipe.rate) * k)
        # The weight is part of Q_N here, for the oracle takes it as a float.
        R_ = real(np.array([[float(recipe.R)]]))
        u = oracle.riccati(A, B, unit * int(recipe.Q), R_, unit * int(recipe.QN) * weight, 1.0, recipe.horizon, X)[0]
        outputs.append(now)
        inputs.append(u)
        v = [u, *v]
        if example == "linear":
            z = quotient(np.array(recipe.plant.F, dtype=object)) @ z + quotient(np.array(recipe.plant.G)) * u
        else:
            a, b, c, d, e, f = quotient(np.array(recipe.plant.coefficients))
            rate = np.array([z[1], a * z[2] - b * z[1] - c * mpmath.sin(z[0]), f * u - d * z[2] - e * z[1]])
            z = z + rate / 100
    return outputs, inputs


@pytest.mark.parametrize("example", RECIPES)
def test_enclosures_hold_what_extended_precision_finds(example):
    run, (outputs, inputs) = (linear_run if example == "linear" else robot_run)(), extended(example)
    with flint.ctx.workprec(run.bits):
        for balls, found in zip((*run.y, run.u), (*outputs, inputs), strict=True):
            for enclosed, number in zip(balls, found, strict=True):
                # mpmath's own rounding, enlarged by the run, stands for the radius that it does not keep.
                near = flint.arb(str(mpmath.nstr(number, 75)), 1e-40)
                assert near.overlaps(enclosed)
                assert not flint.arb(str(mpmath.nstr(number + mpmath.mpf(10) ** -30, 75)), 1e-40).overlaps(enclosed)


@pytest.mark.parametrize("example", RECIPES)
def test_float64_is_near(example):
    run = (linear_run if example == "linear" else robot_run)()
    found = errors_of(RECIPES[example][1]().run(), run)
    assert len(found) == (3 if example == "linear" else 7)
    assert all(0 < error.low <= error.high < 1e-12 for error in found)


def test_errors_of_another_run_are_seen():
    other = published.linear_example(printed=True).run()
    assert max(error.low for error in errors_of(other, linear_run())) > 0.1
    with pytest.raises(InputError, match="trace must have 42 steps with 1 outputs, got 62 with 3"):
        errors_of(published.robot_arm().run(), linear_run())


@pytest.mark.parametrize(("run", "bits"), [(linear_run, TOO_FEW_LINEAR), (robot_run, TOO_FEW_ROBOT)])
def test_too_few_bits_leave_whole_lines_and_never_a_false_word(run, bits):
    few, enough = run(bits), run()
    example = "linear" if run is linear_run else "robot"
    assert bounds(few.u[-1]) == (-math.inf, math.inf)
    assert digits(few.u[-1]) == 0
    assert unlike(few.u, enough.u) == []
    pairs = list(zip(beside_published(few, example), beside_published(enough, example), strict=True))
    assert any(one.met is None for one, _ in pairs)
    assert all(one.met in (None, other.met) for one, other in pairs)
    assert all(other.met is not None for _, other in pairs)


@pytest.mark.parametrize(
    "change",
    [
        {"rate": Fraction(100) + Fraction(1, 10**12)},
        {"R": Fraction(10000) - Fraction(1, 10**9)},
        {"horizon": 19},
        {"window": 9},
        {"mixing": Fraction(1, 10**15)},
    ],
)
def test_another_setting_is_proved_to_give_another_run(change):
    other = enclose(replace(linear_recipe(), **change), 5000)
    # The first output is the plant's own; inputs differ from where the setting first counts.
    differing = unlike(other.u, linear_run().u)
    assert len(differing) > 20
    assert unlike(linear_run().u, enclose(linear_recipe(), 5000).u) == []


def test_published_samples_are_met_and_missed_where_they_are_said_to_be():
    samples = beside_published(linear_run(), "linear")
    assert {of.signal for of in samples} == set(FIRST_MISSED)
    assert all(of.met is (of.k < FIRST_MISSED[of.signal]) for of in samples)
    assert all(of.met for of in beside_published(robot_run(), "robot"))
    assert not all(of.met for of in beside_published(robot_run(printed=True), "robot"))


def test_signals_are_those_of_the_example():
    assert [f"linear_{name}" for name in signals(linear_run(), "linear")] == [
        f"linear_{name}" for name in ("y", "y_hat", "u", "x1", "gamma_over_eps")
    ]
    with pytest.raises(InputError, match="example must be 'linear' or 'robot', got 'arm'"):
        signals(linear_run(), "arm")


def test_augmentation_is_the_library_s():
    recipe, model = linear_recipe(), SignalModel(np.arange(16.0).reshape(4, 4), np.arange(16.0).reshape(4, 4))
    theta = flint.arb_mat([[ball(entry) for entry in row] for row in np.hstack([model.A, model.B])])
    A, B = certified._augment(recipe, theta)
    expected = DelayLifting(4, 4).augment(model)
    np.testing.assert_array_equal(np.array(A.tolist(), dtype=float), expected.A)
    np.testing.assert_array_equal(np.array(B.tolist(), dtype=float), expected.B)


def test_digits_count_no_more_than_is_proved():
    for places in (5, 20, 100):
        with flint.ctx.workprec(1000):
            enclosed = flint.arb(3, flint.arb(10) ** -places)
            proved = digits(enclosed)
            assert places - 1 <= proved <= places
            assert enclosed.rad() < abs(enclosed) * flint.arb(10) ** -proved
    assert digits(flint.arb(0, 1)) == digits(whole_line()) == 0


def test_bounds_are_rounded_outwards():
    with flint.ctx.workprec(300):
        third = flint.arb(1) / 3
        low, high = bounds(third)
        assert Fraction(low) < Fraction(1, 3) < Fraction(high)
        assert high - low < 1e-15


def test_a_ball_holds_its_fraction_and_a_float_is_what_it_holds():
    assert ball(Fraction(1, 3)).contains(flint.fmpq(1, 3))
    assert not ball(0.1).contains(flint.fmpq(1, 10)) or not ball(0.1).is_exact()
    with flint.ctx.workprec(200):
        assert not ball(0.1).contains(flint.fmpq(1, 10))
        assert ball(decimal(0.1)).contains(flint.fmpq(1, 10))


def test_a_missing_package_is_one_sentence_that_names_the_extra(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "flint", None)
    with pytest.raises(ModuleNotFoundError, match=r"python-flint, got none installed; pip install 'rhl\[paper\]'"):
        certified_samples.flint()
    assert main(["verify", "certified.lemma-4", "--fast"]) == 2
    said = capsys.readouterr().err
    assert "flint" in said
    assert "pip install 'rhl[paper]'" in said
    # Whatever the claim: a table that ends in the middle would say less.
    assert main(["verify", "eq-22", "--fast"]) == 2


def of_scheme(part, **changes):
    """Return what changes a part of an experiment's scheme."""
    return lambda e: replace(e, scheme=replace(e.scheme, **{part: replace(getattr(e.scheme, part), **changes)}))


@pytest.mark.parametrize(
    "changed",
    [
        of_scheme("estimator", generator=WeightedSquares(0.01)),
        of_scheme("estimator", loss=WeightedSquares(3.0)),
        of_scheme("controller", bounds=Saturation(-1, 1)),
        of_scheme("controller", adaptive=True),
        lambda e: replace(e, scheme=replace(e.scheme, set_point=SetPoint(1.0))),
        lambda e: replace(e, actuator=Saturation(-1, 1)),
        lambda e: replace(e, sensor=lambda k, y: y),
        lambda e: replace(e, plant=FunctionPlant(lambda z, v: z, lambda z: z[:1], 3, 1)),
    ],
)
def test_another_scheme_is_not_certified(changed):
    with pytest.raises(InputError, match="must be one of the paper's experiments"):
        recipe_of(changed(published.linear_example()))
