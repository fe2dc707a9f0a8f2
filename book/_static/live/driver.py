"""What the page that runs rhl does with it: settings as they are typed, a run step by step, its numbers.

The page lets an interpreter in the browser run this file, with `stand_in` as numpy. It runs beside numpy too, where
the tests hold `prepare` against `rhl.simulate`.
"""

import numpy as np

from rhl import Controller, DelayLifting, LinearPlant, PowerDecay, ProximalEstimator, Scheme, SignalModel, _engine
from rhl._checks import describe, integer, real_array
from rhl.closed_loop import check_loop
from rhl.controllability import ConstantMixing, controllability_margin
from rhl.errors import DivergedError, InputError, RHLError
from rhl.kernels import loops
from rhl.losses import WeightedSquares
from rhl.schedules import epsilons

loops.np = getattr(np, "loops", np)

# More would keep a reader waiting; the library itself has no such bounds.
MOST = {"m": 12, "window": 200, "N": 200, "steps": 500}
MOST_SIGNALS = 30
# Multiplications of the plans of a run; an interpreter takes about a minute for them.
MOST_WORK = 4e7


def number(text):
    """Return the number that a field holds, or the text as it is, for rhl to refuse."""
    text = text.strip().replace("\N{MINUS SIGN}", "-")
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            pass
    return text


def matrix(text):
    """Return what a field holds: rows by lines or semicolons, entries by blanks or commas, brackets as one likes.

    What is no number stays the text that it is, for rhl to refuse.
    """
    rows = text.replace("],", ";").replace("[", " ").replace("]", " ").replace("\n", ";").split(";")
    found = [[number(entry) for entry in row.replace(",", " ").split()] for row in rows]
    return [row for row in found if row]


def vector(text):
    """Return what a field holds, its entries by blanks, commas, semicolons or lines."""
    return [entry for row in matrix(text) for entry in row]


def weight(text):
    """Return a weight: a number, or a matrix."""
    found = matrix(text)
    return found[0][0] if [len(row) for row in found] == [1] else found


def prepare(settings):
    """Return plant, scheme, z(0) and the number of steps, of the page's fields; InputError as rhl words it."""
    for name, most in MOST.items():
        _at_most(most, name, number(settings[name]))
    plant = LinearPlant(matrix(settings["F"]), matrix(settings["G"]), matrix(settings["H"]))
    order = number(settings["m"])
    if isinstance(order, int):
        _at_most(MOST_SIGNALS, "m times the number of outputs and inputs", order * (plant.p + plant.q))
    scheme = Scheme(
        lifting=DelayLifting(order, order),
        estimator=ProximalEstimator(
            window=number(settings["window"]), generator=WeightedSquares(number(settings["rho"]))
        ),
        controller=Controller(
            *(weight(settings[name]) for name in ("Q", "R", "QN")),
            horizon=number(settings["N"]),
            epsilon=PowerDecay(number(settings["eta"])),
            model_delay=number(settings["delay"]),
        ),
        initial_model=SignalModel.companion_of_ones(plant.p * order, plant.q * order),
        mixing=ConstantMixing(number(settings["lambda"])),
    )
    steps = integer("steps", number(settings["steps"]), 1)
    size = scheme.lifting.augment(scheme.initial_model).n
    work = steps * scheme.controller.horizon * size**2 * (size + plant.q)
    if work > MOST_WORK:
        raise InputError(
            f"steps, N and m must be small enough for a run of about a minute on this page, got {work / MOST_WORK:.3g} "
            "times as much; lower one of them"
        )
    return plant, scheme, check_loop(scheme, plant, vector(settings["z0"]), True), steps


def _at_most(most, name, value):
    if isinstance(value, int) and value > most:
        raise InputError(f"{name} must be at most {most} on this page, got {describe(value)}")


def push(settings, plant):
    """Return the step at which the plant's input is disturbed, and by how much, shape (q,); zero leaves it alone."""
    at = integer("the step of the disturbance", number(settings["push_step"]), 0)
    size = real_array("the size of the disturbance", vector(settings["push_size"]), (None,))
    if size.shape not in ((1,), (plant.q,)):
        raise InputError(f"the size of the disturbance must have 1 or {plant.q} entries, got {len(size)}")
    return at, [float(size[min(i, len(size) - 1)]) for i in range(plant.q)]


class Run:
    """A run that is taken step by step, so that a page stays responsive and can stop it."""

    def __init__(self, settings):
        self.plant, self.scheme, z, self.steps = prepare(settings)
        self.at, self.size = push(settings, self.plant)
        plant = self.plant
        (self.block,) = _engine.begin(self.scheme, (), (plant.F, plant.G, plant.H), z)
        self.k = 0

    def step(self):
        """Take a step; return y, v, the terminal weight and the two margins as plain numbers."""
        k, block, controller = self.k, self.block, self.scheme.controller
        try:
            signals, models = _engine.run(block, k, epsilons(controller.epsilon, k, k + 1), None, True)
        except (OverflowError, ZeroDivisionError):  # Python raises where the compiled loop goes on with infinity
            block.diverged_at[0] = k
        if 0 <= block.diverged_at[0] <= k:
            raise DivergedError(k, "the scheme's or the plant's numbers are no longer finite")
        y, v, _ = ([float(rows[0, a, 0]) for a in range(rows.shape[1])] for rows in signals)
        x, u, _, _ = block.state
        state = [x[0, a, 0] for a in range(x.shape[1])]
        # u holds v(k-1), ..., and the last of them is no part of the augmented state.
        state += [u[0, a, 0] for a in range(u.shape[1] - self.scheme.q)]
        with np.errstate(over="ignore"):
            terminal = float(controller.weight(np.array(state), k))
        n = self.scheme.initial_model.n
        theta = models[1][0, :, :, 0]
        model = SignalModel(theta[:, :n], theta[:, n:])
        margins = [float(controllability_margin(of)) for of in (model, self.scheme.lifting.augment(model))]
        if k == self.at:
            for a in range(self.plant.n):
                block.z[a, 0] += sum(float(self.plant.G[a, b]) * self.size[b] for b in range(self.plant.q))
        self.k += 1
        return {"y": y, "v": v, "weight": terminal, "lifted": margins[0], "augmented": margins[1]}


def start(settings):
    """Return a run and "", or None and the sentence with which rhl refuses the settings."""
    try:
        return Run(settings), ""
    except RHLError as error:
        return None, str(error)


def advance(run):
    """Return what the next step came to and "", or None and why there is none: "" at the end of the run."""
    if run.k == run.steps:
        return None, ""
    try:
        return run.step(), ""
    except DivergedError as error:
        return None, str(error)


def whole(settings):
    """Return all steps of a run, and the sentence with which it was refused or ended early, or ""."""
    run, said = start(settings)
    taken = []
    while run is not None and not said:
        row, said = advance(run)
        if row is None:
            break
        taken.append(row)
    return taken, said
