"""Certified numbers: statements about the simulations and counterexamples, proved in ball arithmetic.

The inputs are exact, every rounding enlarges a ball accordingly, and a check passes if its statement holds for every
number in the balls. Nothing is random, and with too few bits a check fails.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from fractions import Fraction
from functools import cache, partial

from rhl.paper import published
from rhl.paper.certified import LINEAR_BITS, ROBOT_BITS, Enclosure, ball, decimal, enclose, flint
from rhl.paper.certified import linear_recipe as linear
from rhl.paper.certified import robot_recipe as robot
from rhl.paper.certified_samples import Sample, beside_published, bounds, digits, errors_of
from rhl.paper.claims.certified_limits import Gain, blended, growth, settling, shrinking_limit, vanishing
from rhl.paper.claims.claim import Claim, Control, Effort, Evidence

_PAGE = "notebooks/23-certified-numbers.ipynb"
_claim = partial(Claim, page=_PAGE, test="tests/paper/claims/test_certified.py", proof=f"{_PAGE}#the-proof")

_FOR_EVER = f"{_PAGE}#loops-that-run-for-ever"

# With these precisions the runs lose all digits before they end.
TOO_FEW_LINEAR, TOO_FEW_ROBOT = 1600, 3000
# The first sample of each signal that the three unexplained inputs affect; the arm's signals have none.
FIRST_MISSED = {"y": 14, "y_hat": 13, "u": 12, "x1": 14, "gamma_over_eps": 12}
# The recipe's u(12) to forty digits, and bounds of its distance from the published input.
INPUT_12 = "-3.273916699251995115045657834880159709682"
MISSED_BY = (Fraction("0.0052465670843851"), Fraction("0.0052465670843852"))
# The same for the three inputs with the published signals fed back.
FED_MISSED_BY = {
    12: (Fraction("0.00524656708492413"), Fraction("0.00524656708492414")),
    13: (Fraction("0.06626561377475683"), Fraction("0.06626561377475687")),
    14: (Fraction("0.05407940729922859"), Fraction("0.05407940729922861")),
}
_FED_MISSES = ", ".join(f"{float(low):.7f}" for low, _ in FED_MISSED_BY.values())
PROVED_DIGITS = 300
# A proved bound of the library's errors, over all outputs, inputs and predictions.
FLOAT64 = 1e-12
LIMIT = "0.0699037402991845996183260179504957087057"


@cache
def linear_run(bits: int = LINEAR_BITS, *, printed: bool = False) -> Enclosure:
    """Enclose the linear example; ``printed``: with the settings of the text."""
    return enclose(linear(printed=printed), bits)


@cache
def robot_run(bits: int = ROBOT_BITS, *, printed: bool = False) -> Enclosure:
    """Enclose the robot arm; ``printed``: with the coefficients of the text."""
    return enclose(robot(printed=printed), bits)


@cache
def fed_run(bits: int = LINEAR_BITS, *, printed: bool = False) -> Enclosure:
    """Enclose the inputs of the linear example's scheme for the published outputs and inputs."""
    y, v = ([decimal(value) for value in published.curve(name)] for name in ("linear_y", "linear_u"))
    return enclose(linear(printed=printed), bits, (y, v))


def _false(facts: Sequence[bool]) -> Evidence:
    """Count the facts without a proof."""
    return Evidence(len(facts), float(sum(not fact for fact in facts)), 0.0, "a statement is either proved or not")


def check_linear(effort: Effort, bits: int = LINEAR_BITS) -> Evidence:
    """Count published samples of the linear example without a proof that they agree or differ as in ``FIRST_MISSED``.

    ``effort`` is not used here and below, since nothing is random. ``bits``: the precision.
    """
    samples = beside_published(linear_run(bits), "linear")
    return _false([of.met is (of.k < FIRST_MISSED[of.signal]) for of in samples])


def check_input_12(effort: Effort, *, printed: bool = False) -> Evidence:
    """Count the unproved facts about u(12): forty digits, and the bounds of its distance from the published input.

    ``printed``: with eps as the text has it.
    """
    run = linear_run(printed=printed)
    (sample,) = (of for of in beside_published(run, "linear", ("u",)) if of.k == 12)
    with flint().ctx.workprec(run.bits):
        said = ball(Fraction(INPUT_12))
        near = bool(abs(sample.value - said) < ball(Fraction(1, 10**39)))
    return _false([near, _within(sample, MISSED_BY, run.bits)])


def _within(sample: Sample, ends: tuple[Fraction, Fraction], bits: int) -> bool:
    with flint().ctx.workprec(bits):
        low, high = map(ball, ends)
        return bool(low < sample.distance) and bool(sample.distance < high)


def check_fed(effort: Effort, *, printed: bool = False) -> Evidence:
    """Count published inputs without a proof of agreement when the published signals are fed back, except for three.

    For these three the distances are proved. ``printed``: with the text's eps.
    """
    run = fed_run(printed=printed)
    samples = beside_published(run, "linear", ("u",))
    facts = [of.met is True for of in samples if of.k not in FED_MISSED_BY]
    facts += [_within(of, FED_MISSED_BY[of.k], run.bits) for of in samples if of.k in FED_MISSED_BY]
    return _false(facts)


def check_robot(effort: Effort, bits: int = ROBOT_BITS) -> Evidence:
    """Count published samples of the robot arm without a proof of agreement. ``bits``: the precision."""
    return _false([of.met is True for of in beside_published(robot_run(bits), "robot")])


def check_digits(effort: Effort, linear_bits: int = LINEAR_BITS, robot_bits: int = ROBOT_BITS) -> Evidence:
    """Count the values of both runs with fewer than ``PROVED_DIGITS`` proved digits."""
    values = []
    for run in (linear_run(linear_bits), robot_run(robot_bits)):
        values += [*run.u, *(entry for rows in (run.y, run.y_hat, run.z) for row in rows for entry in row)]
        values += run.gamma_over_eps
    with flint().ctx.workprec(LINEAR_BITS):
        return _false([digits(value) >= PROVED_DIGITS for value in values])


def check_float64(effort: Effort, moved: float = 0.0) -> Evidence:
    """Bound the largest error of the library's runs. ``moved``: offset of the library's initial states."""
    found = []
    for experiment, run in ((published.linear_example(), linear_run()), (published.robot_arm(), robot_run())):
        found += errors_of(replace(experiment, z0=experiment.z0 + moved).run(), run)
    return Evidence(len(found), max(error.high for error in found), FLOAT64, "the accuracy of float64 runs")


def check_lemma_4(effort: Effort, ratio: Fraction = Fraction(1, 2)) -> Evidence:
    """Bound the distance of the limit of Lemma 4's first counterexample from the number in the statement."""
    limit = shrinking_limit(ratio, 400, 600)
    with flint().ctx.workprec(600):
        return Evidence(1, bounds(abs(limit - ball(Fraction(LIMIT))))[1], 1e-40, "the last digit in the statement")


# Unstable plants and initial states; for all others the inequality checked along these is proved.
_SLOPES = (Fraction(101, 100), Fraction(11, 10), Fraction(3, 2))
_STARTS = (Fraction(1, 1000), Fraction(-1, 10), Fraction(1), Fraction(1000))


def check_theorem_1(effort: Effort, gain: Gain = vanishing) -> Evidence:
    """Count steps of the scalar loop without a proof that the state is as large as divergence requires.

    ``gain``: the predictor's b(k).
    """
    runs = [growth(a, x0, gain, 150, 400) for a in _SLOPES for x0 in _STARTS]
    facts = [fact for run in runs for fact in [True] * run.kept + [False] * (run.steps - run.kept)]
    return _false(facts + [bool(run.factor > 1) for run in runs])


def check_blended(effort: Effort, ratio: Fraction = Fraction(1, 2)) -> Evidence:
    """Count the unproved facts about the loop with decaying input gains: that x1 tends to 5/26, and bounds of plans.

    ``ratio``: the second input gain's. The facts: every deviation from the limit's recursion is below its bound, and
    the sum of later bounds is small; |x1| stays below 2, and at the end x1 is near 5/26; inputs of plans are below
    1.25 |x|, those of V2's below 1.42 |x|, at every computed step and at all later ones.
    """
    steps, bits = 240, 1500
    loop = blended(steps, bits, ratio)
    with flint().ctx.workprec(bits):
        facts = [bool(gap <= bound) for gap, bound in zip(loop.gap, loop.bound, strict=True)]
        facts += [bool(plan < ball(Fraction(5, 4))) for plan in (*loop.plan, loop.later)]
        facts += [bool(least < ball(Fraction(71, 50))) for least in (*loop.least, loop.later)]
        facts += [bool(abs(x) < 2) for x in loop.x1]
        facts.append(bool(loop.rest < ball(Fraction(1, 10**15))))
    return _false(facts)


def _printed(check: Callable[..., Evidence]) -> Control:
    return Control("the eps rate as printed", lambda effort: check(effort, printed=True))


CLAIMS: tuple[Claim, ...] = (
    _claim(
        "certified.linear",
        "Figures 2, 4, 5, 6",
        "subfig1",
        "In the linear example, the recipe provably agrees to 1e-9 with the published samples of y and x1 up to "
        "k = 13, of y_hat up to 12, and of u and Gamma/eps up to 11; it provably differs from all later ones.",
        method="ball arithmetic",
        recorded="holds",
        stated=check_linear,
        control=Control("1600 bits, which are too few", lambda effort: check_linear(effort, TOO_FEW_LINEAR)),
    ),
    _claim(
        "certified.linear.input-12",
        "Figure 4",
        "subfig3",
        f"The recipe's u(12) is {INPUT_12[:24]}..., which is {float(MISSED_BY[0]):.7f} away from the published input.",
        method="ball arithmetic",
        recorded="holds",
        stated=check_input_12,
        control=_printed(check_input_12),
    ),
    _claim(
        "certified.linear.fed",
        "Figure 4",
        "subfig3",
        "With the published outputs and inputs fed back, the recipe's inputs provably agree with the published ones to "
        f"1e-9, except at k = 12, 13, 14, where they differ by {_FED_MISSES}.",
        method="ball arithmetic",
        recorded="holds",
        stated=check_fed,
        control=_printed(check_fed),
    ),
    _claim(
        "certified.robot",
        "Figures 7, 8, 9",
        "subfig:state1",
        "The recipe provably agrees with every published sample of the robot arm to 1e-9.",
        method="ball arithmetic",
        recorded="holds",
        stated=check_robot,
        control=Control("3000 bits, which are too few", lambda effort: check_robot(effort, TOO_FEW_ROBOT)),
    ),
    _claim(
        "certified.digits",
        "text",
        "",
        f"Every state, output, input, prediction and weight of both runs has {PROVED_DIGITS} proved digits.",
        method="ball arithmetic",
        recorded="holds",
        stated=check_digits,
        control=Control(
            "a quarter fewer bits for the linear example", lambda effort: check_digits(effort, LINEAR_BITS * 3 // 4)
        ),
    ),
    _claim(
        "certified.float64",
        "text",
        "",
        "In float64 the library's outputs, inputs and predictions of both examples are provably within 1e-12 of the "
        "exact ones.",
        method="ball arithmetic",
        recorded="holds",
        stated=check_float64,
        control=Control("initial states with an error of 1e-9", lambda effort: check_float64(effort, 1e-9)),
    ),
    _claim(
        "certified.lemma-4",
        "Lemma 4",
        "timevaryingmin",
        f"For f(x,k) = 2^-k x^2, D = |x-y|^2/2 the iteration tends from x = 1 to {LIMIT[:22]}..., and X is {{0}}.",
        method="ball arithmetic",
        recorded="holds",
        stated=check_lemma_4,
        control=Control("functions that do not decay", lambda effort: check_lemma_4(effort, Fraction(1))),
        proof=_FOR_EVER,
    ),
    _claim(
        "certified.theorem-1",
        "Theorem 1",
        "MPC1vsMPC3",
        "With N = 1, eps(k) = exp(-k/10) and the predictor ax + b(k)u, b(k) = eps(k) a^-2k / (k+1), the loop of V1 and "
        "x+ = ax + u diverges for every a > 1 and every nonzero x(0).",
        method="ball arithmetic",
        recorded="holds",
        stated=check_theorem_1,
        control=Control("b(k) that tends to the true 1", lambda effort: check_theorem_1(effort, settling)),
        proof=_FOR_EVER,
    ),
    _claim(
        "certified.theorem-1.forgetting",
        "Theorem 1",
        "MPC1vsMPC3",
        "With A = diag(1.2, 0.5), B = (1, 0), models (1, 2^-k) of B, N = 2, eps(k) = 0.02^k and x(0) = (1, 1) the "
        "planned inputs along the loop stay below 1.25 |x|, and x1 tends to 5/26.",
        method="ball arithmetic",
        recorded="holds",
        stated=check_blended,
        control=Control("models (1, 1) of B", lambda effort: check_blended(effort, Fraction(1))),
        proof=_FOR_EVER,
    ),
)
