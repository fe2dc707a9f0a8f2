"""Runs step by step as plain data: the scheme's data, model and plan at every k; and a comparison of runs."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from rhl._checks import Array, choice
from rhl.memory import GrowingMemory
from rhl.paper.published import Experiment, linear_example, robot_arm
from rhl.paper.sweeps import plain, to_json
from rhl.plants.benchmarks import benchmark
from rhl.scheme import Scheme, default_scheme
from rhl.simulation import simulate
from rhl.study.rivals import known_plant, pose
from rhl.trace import Trace

Name = Literal["ball", "linear", "arm"]
NAMES: tuple[Name, ...] = ("ball", "linear", "arm")

_BALL_STEPS = 41
_INDEX = str.maketrans("-0123456789", "₋₀₁₂₃₄₅₆₇₈₉")


@dataclass(frozen=True, eq=False)
class Watched:
    """An experiment to be shown step by step, with the names of its signals.

    ``title`` names it; ``outputs`` and ``inputs`` name each entry of y and v with its unit; ``start`` is the first step
    shown, at which the model is still being learned.
    """

    title: str
    experiment: Experiment
    outputs: tuple[str, ...]
    inputs: tuple[str, ...]
    start: int


def suspended_ball() -> Experiment:
    """Return a ball below an electromagnet, an unstable plant, under the default scheme.

    The plant is the benchmark "maglev"; the scheme has one output, one input, and the order of the plant.

    Examples
    --------
    >>> trace = suspended_ball().run()
    >>> bool(abs(trace.y[-1, 0]) < 1e-6 < abs(trace.y[0, 0]) < abs(trace.y).max())
    True
    """
    ball = benchmark("maglev")
    plant = ball.sampled()
    return Experiment(ball.title, plant, ball.z0, default_scheme(plant.p, plant.q, ball.order()), _BALL_STEPS)


def watched(name: Name) -> Watched:
    """Return the experiment of that name: "ball", "linear" or "arm"; InputError if there is none.

    Examples
    --------
    >>> watched("arm").outputs
    ('angle x₁ (rad)', 'velocity x₂ (rad/s)', 'current x₃ (A)')
    """
    choice("name", name, NAMES)
    if name == "ball":
        found = benchmark("maglev")
        return Watched("The suspended ball", suspended_ball(), found.outputs, found.inputs, 7)
    if name == "linear":
        return Watched("The linear example", linear_example(), ("output y",), ("input v",), 9)
    outputs = ("angle x₁ (rad)", "velocity x₂ (rad/s)", "current x₃ (A)")
    return Watched("The robot arm", robot_arm(), outputs, ("input v (V)",), 12)


def fitted(scheme: Scheme, k: int) -> tuple[int, int] | None:
    """Return the first and the last output y(j) that the model of step k is fitted to; None if there is none yet.

    A transition from x(j-1) to x(j) belongs to the output y(j). Those from before k = 0 are zero and are left out.

    Examples
    --------
    >>> fitted(linear_example().scheme, 12), fitted(linear_example().scheme, 3)
    ((5, 12), (0, 3))
    """
    if isinstance(scheme.estimator, GrowingMemory):
        return (scheme.first_measured, k) if k >= scheme.first_measured else None
    return max(0, k - scheme.estimator.window + 1), k


def steps(name: Name) -> dict[str, Any]:
    """Return a watched run as plain data: lists over k, and for each k the plan.

    Keys: ``title``, ``outputs``, ``inputs``, ``start``; ``y``, ``predicted``, ``v``, one list for each signal;
    ``weight``; ``fitted``, see there; ``of_outputs`` and ``of_inputs``, the entries of the model's first rows, those
    that predict y(k+1), each with its ``name`` and its ``values`` over k; ``planned_y`` and ``planned_v``, for each k
    one list for each signal over the N steps ahead; ``lag``, the delay of the model used for the plan, in steps.

    Examples
    --------
    >>> data = steps("linear")
    >>> len(data["y"][0]), len(data["planned_y"][7][0]), len(data["planned_v"][7][0]), data["fitted"][12]
    (42, 21, 20, (5, 12))
    """
    what = watched(name)
    trace = what.experiment.run()
    scheme, p = trace.scheme, trace.scheme.p
    of_outputs, of_inputs = entries(trace)
    plans = [trace.plan(k) for k in range(len(trace))]
    return {
        "title": what.title,
        "outputs": list(what.outputs),
        "inputs": list(what.inputs),
        "start": what.start,
        "lag": scheme.controller.model_delay,
        "horizon": scheme.controller.horizon,
        "y": [plain(row) for row in trace.y.T],
        "predicted": [plain(row) for row in trace.y_hat.T],
        "v": [plain(row) for row in trace.v.T],
        "weight": plain(trace.weight),
        "fitted": [fitted(scheme, k) for k in range(len(trace))],
        "of_outputs": [{"name": name, "values": plain(values)} for name, values in of_outputs.items()],
        "of_inputs": [{"name": name, "values": plain(values)} for name, values in of_inputs.items()],
        "planned_y": [[plain(row) for row in plan.x[:, :p].T] for plan in plans],
        "planned_v": [[plain(row) for row in plan.u.T] for plan in plans],
    }


def entries(trace: Trace) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return the entries of the model that predict y(k+1), over k: those of past outputs, and those of inputs.

    Examples
    --------
    >>> of_outputs, of_inputs = entries(linear_example().run())
    >>> list(of_outputs)[:2], list(of_inputs)[-1], of_outputs["y(k)"].shape
    (['y(k)', 'y(k−1)'], 'v(k−3)', (42,))
    """
    scheme = trace.scheme
    p, q, n = scheme.p, scheme.q, trace.model(0).n
    models = [trace.model(k) for k in range(len(trace))]
    A, B = np.stack([of.A[:p] for of in models]), np.stack([of.B[:p] for of in models])

    def named(M: Array, signal: str, size: int) -> dict[str, Array]:
        found = {}
        for row in range(p):
            for column in range(M.shape[2]):
                back, which = divmod(column, size)
                sign = signal if size == 1 else signal + str(which + 1).translate(_INDEX)
                what = f"{sign}(k)" if back == 0 else f"{sign}(k−{back})"
                goal = "" if p == 1 else f" in y{str(row + 1).translate(_INDEX)}(k+1)"
                found[what + goal] = M[:, row, column]
        return found

    return named(A[..., :n], "y", p), named(B, "v", q)


def contrast() -> dict[str, Array]:
    """Return the suspended ball's position (m) three times, each shape (steps,), from the same initial state.

    "left alone": no input. "known model": the regulator that knows the plant and its state. "this scheme": the default
    scheme, which knows neither.

    Examples
    --------
    >>> {name: bool(abs(y[-1]) > 100 * abs(y[0])) for name, y in contrast().items()}
    {'left alone': True, 'known model': False, 'this scheme': False}
    """
    ball, example = benchmark("maglev"), suspended_ball()
    plant = ball.sampled()
    task = pose(plant, ball.z0, ball.order(), example.steps)
    alone = [ball.z0]
    for _ in range(example.steps - 1):
        alone.append(plant.step(alone[-1], np.zeros(plant.q)))
    return {
        "left alone": plant.output(np.stack(alone))[:, 0],
        "known model": known_plant(task).y[:, 0],
        "this scheme": simulate(example.scheme, plant, ball.z0, example.steps).y[:, 0],
    }


def files() -> Iterator[tuple[str, str]]:
    """Yield the name, without its ending, and the JSON of the file of each watched run."""
    for name in NAMES:
        yield f"watch-{name}", to_json(steps(name))
