"""The paper's two simulations: equations (23) and (24), the figures, and what the text says of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial

import numpy as np

from rhl._checks import Array
from rhl.paper import published
from rhl.paper.claims.claim import Claim, Control, Effort, Evidence
from rhl.plants import Plant
from rhl.simulation import simulate
from rhl.trace import Trace

_claim = partial(Claim, page="notebooks/03-text-against-data.ipynb", test="tests/paper/claims/test_simulations.py")

_CURVE = 1e-9


# Equation (23) in hundredths, so that everything about it can be decided in integers.
_F = ((0, 100, 10), (0, 102, 0), (0, 0, 92))
_G = ((0,), (1,), (0,))
_H = ((1, 0, 1),)


def check_linear_rank(effort: Effort, what: str, modes: tuple[str, ...] | None = None) -> Evidence:
    """PBH rank tests on equation (23) in exact arithmetic: by how much the least rank misses the order 3.

    ``effort`` is not used: nothing is drawn. ``what`` {"input", "output"}: test (F, G) or (F, H).
    ``modes``: eigenvalues to test; those of modulus at least 1 for the input, all for the output, where omitted.
    """
    import sympy as sp  # here, because it takes a while to load

    F, G, H = sp.Matrix(_F) / 100, sp.Matrix(_G), sp.Matrix(_H)
    found = sorted(F.eigenvals())
    chosen = [sp.Rational(mode) for mode in modes] if modes else [x for x in found if what == "output" or abs(x) >= 1]
    if not set(chosen) <= set(found):
        return Evidence(0, np.nan)
    pencil = [(x * sp.eye(3) - F).row_join(G) if what == "input" else (x * sp.eye(3) - F).col_join(H) for x in chosen]
    return Evidence(len(pencil), float(max(3 - M.rank() for M in pencil)))


def check_linear_unstable(effort: Effort, pole: str = "51/50") -> Evidence:
    """Look for an eigenvalue of modulus above 1 in equation (23), exactly.

    ``effort`` is not used: nothing is drawn. ``pole``: put this number in the place of 1.02.
    """
    import sympy as sp

    F = sp.Matrix(_F) / 100
    F[1, 1] = sp.Rational(pole)
    return Evidence(3, 0.0 if max(abs(x) for x in F.eigenvals()) > 1 else 1.0)


@cache
def _run(example: str, printed: bool) -> Trace:
    return (published.linear_example if example == "linear" else published.robot_arm)(printed=printed).run()


def check_curve(effort: Effort, signal: str, printed: bool) -> Evidence:
    """Compare a run of the linear example with a published curve, up to where it is explained.

    ``effort`` is not used: nothing is drawn. ``printed``: with the text's settings.
    """
    rows = published.compare_linear(_run("linear", printed), printed=printed)
    row = next(row for row in rows if row.signal.split(",")[0].split(" ")[0] == signal)
    assert row.tolerance is not None
    return Evidence(row.samples, row.largest, row.tolerance, "fifteen published digits, enlarged by an unstable plant")


def check_arm_curve(effort: Effort, state: int, printed: bool) -> Evidence:
    """Compare a run of the robot arm with the published curve of x1, x2 or x3, all samples.

    ``effort`` is not used: nothing is drawn. ``state``: 0, 1 or 2.
    ``printed``: with the text's coefficients.
    """
    row = published.compare_robot(_run("robot", printed))[state]
    return Evidence(row.samples, row.largest, _CURVE, "fifteen published digits, enlarged by the transient")


def check_arm_equation(effort: Effort, printed: bool) -> Evidence:
    """Put the published samples of the arm into the second line of (24), which holds no input."""
    a, b, c = (36.4, 1.7, 1309.0) if printed else (400 / 11, 19.12 / 11, 1000 / 11)
    x1, x2, x3 = (published.curve(f"robot_x{i}") for i in (1, 2, 3))
    gap = np.abs(np.diff(x2) - 0.01 * (a * x3 - b * x2 - c * np.sin(x1))[:-1])
    return Evidence(len(gap), float(np.max(gap)), 1e-12, "the last published digit of x2")


def check_settled(effort: Effort, example: str, deaf: bool = False) -> Evidence:
    """Run an example on for 300 steps and see how large its state is at the end, relative to its peak.

    ``effort`` is not used: nothing is drawn. ``deaf``: cut the input off.
    """
    chosen = published.linear_example() if example == "linear" else published.robot_arm()
    plant: Plant = chosen.plant
    if deaf:
        plant = _Deaf(plant)
    size = np.linalg.norm(simulate(chosen.scheme, plant, chosen.z0, 300).z, axis=-1)
    return Evidence(1, float(size[-1] / np.max(size)), 1e-4, "slow modes still decay when the run ends")


@dataclass(frozen=True)
class _Deaf:
    """A plant that does not hear its input."""

    heard: Plant

    @property
    def n(self) -> int:
        return self.heard.n

    @property
    def q(self) -> int:
        return self.heard.q

    @property
    def p(self) -> int:
        return self.heard.p

    def step(self, z: Array, v: Array) -> Array:
        return self.heard.step(z, 0 * v)

    def output(self, z: Array) -> Array:
        return self.heard.output(z)


def _figure(number: int, label: str, statement: str, check: Callable[[Effort, bool], Evidence], reason: str) -> Claim:
    return _claim(
        f"figure-{number}",
        f"Figure {number}",
        label,
        statement,
        method="simulation",
        recorded="holds-corrected",
        stated=lambda effort: check(effort, True),
        corrected=lambda effort: check(effort, False),
        control=Control("the settings as printed", lambda effort: check(effort, True)),
        reason=reason,
    )


_RATE = "The data were made with eps(k) = 1/(1+100k), not 1/(1+1000k), and with the model of the step before"
_ARM = "The data obey other coefficients than those printed, and lambda = 0.5 at every step."

CLAIMS: tuple[Claim, ...] = (
    _claim(
        "eq-23",
        "Equation 23",
        "eq:lin_Model2",
        "The plant of the linear example is the one behind its published curves.",
        method="simulation",
        recorded="holds",
        stated=lambda effort: check_curve(effort, "x1", False),
        control=Control("the eps rate as printed", lambda effort: check_curve(effort, "x1", True)),
    ),
    _claim(
        "eq-24",
        "Equation 24",
        "eq:Waste2Ener2",
        "The published samples of the robot arm obey its second equation.",
        method="numerical sampling",
        recorded="holds-corrected",
        stated=lambda effort: check_arm_equation(effort, True),
        corrected=lambda effort: check_arm_equation(effort, False),
        control=Control("the coefficients as printed", lambda effort: check_arm_equation(effort, True)),
        reason="The data obey 400/11, 19.12/11 and 1000/11 where 36.4, 1.7 and 1309 are printed.",
    ),
    _claim(
        "text-linear-unstable",
        "text",
        "",
        "The linear example is unstable.",
        method="exact arithmetic",
        recorded="holds",
        stated=check_linear_unstable,
        control=Control("0.98 in the place of 1.02", lambda effort: check_linear_unstable(effort, "49/50")),
    ),
    _claim(
        "text-linear-stabilizable",
        "text",
        "",
        "The linear example is stabilizable.",
        method="exact arithmetic",
        recorded="holds",
        stated=lambda effort: check_linear_rank(effort, "input"),
        control=Control(
            "its stable mode 0.92 too", lambda effort: check_linear_rank(effort, "input", ("51/50", "23/25"))
        ),
    ),
    _claim(
        "text-linear-observable",
        "text",
        "",
        "The linear example is observable.",
        method="exact arithmetic",
        recorded="holds",
        stated=lambda effort: check_linear_rank(effort, "output"),
        control=Control(
            "the input's side, on which 0.92 is lost", lambda effort: check_linear_rank(effort, "input", ("23/25",))
        ),
    ),
    _claim(
        "text-linear-converges",
        "text",
        "",
        "The linear example's state goes to zero.",
        method="simulation",
        recorded="observed",
        stated=lambda effort: check_settled(effort, "linear"),
        control=Control("the input cut off", lambda effort: check_settled(effort, "linear", deaf=True)),
    ),
    _claim(
        "text-robot-converges",
        "text",
        "",
        "The robot arm's state goes to zero.",
        method="simulation",
        recorded="observed",
        stated=lambda effort: check_settled(effort, "robot"),
        control=Control("the input cut off", lambda effort: check_settled(effort, "robot", deaf=True)),
    ),
    _claim(
        "figure-1",
        "Figure 1",
        "eq:overall_scheme",
        "The overall scheme as a block diagram.",
        reason="A drawing; the book draws it anew and the library runs it.",
    ),
    _figure(
        2,
        "subfig1",
        "The output of the linear example runs as published.",
        lambda e, printed: check_curve(e, "y", printed),
        f"{_RATE}.",
    ),
    _claim(
        "figure-3",
        "Figure 3",
        "subfig2",
        "The estimates of the linear example.",
        reason="Its data are missing from the paper's source.",
    ),
    _figure(
        4,
        "subfig3",
        "The input of the linear example runs as published, up to k = 11.",
        lambda e, printed: check_curve(e, "v", printed),
        f"{_RATE}; the inputs at k = 12, 13, 14 are not explained.",
    ),
    _figure(
        5,
        "subfig4",
        "The first state of the linear example runs as published.",
        lambda e, printed: check_curve(e, "x1", printed),
        f"{_RATE}.",
    ),
    _figure(
        6,
        "subfig:gamma",
        "The terminal weight of the linear example runs as published.",
        lambda e, printed: check_curve(e, "Gamma/eps", printed),
        f"{_RATE}; Gamma is taken one input later than in the controller.",
    ),
    _figure(
        7,
        "subfig:state1",
        "The angle of the robot arm runs as published.",
        lambda e, printed: check_arm_curve(e, 0, printed),
        _ARM,
    ),
    _figure(
        8,
        "subfig:state2",
        "The velocity of the robot arm runs as published.",
        lambda e, printed: check_arm_curve(e, 1, printed),
        _ARM,
    ),
    _figure(
        9,
        "subfig:state3",
        "The current of the robot arm runs as published.",
        lambda e, printed: check_arm_curve(e, 2, printed),
        _ARM,
    ),
)
