"""Functions shared by the book's pages: numbers for the prose, tables of comparisons."""

from __future__ import annotations

import hashlib
import html
import math
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

from rhl.errors import InputError
from rhl.paper.published import Comparison

if TYPE_CHECKING:
    from pandas.io.formats.style import Styler

    from rhl.paper.claims.claim import Judgement


def tell(**values: float | int | str) -> None:
    """Pass numbers or short strings to the prose of the page under their names; outside the book, print them.

    ``**values``: read in the text as ``{glue:text}`name:.2f```. InputError if a number is not finite, so that no page
    shows NaN.
    """
    in_book = "RHL_BOOK" in os.environ
    for name, value in values.items():
        plain = value if isinstance(value, str) else value.item() if hasattr(value, "item") else value
        if not isinstance(plain, str) and not math.isfinite(plain):
            raise InputError(f"{name} must be finite to appear in the text, got {plain}")
        if in_book:
            _glue(name, plain)
        else:
            # Outside the book the prose shows only names, so a reader of the notebook needs the numbers here.
            print(f"{name} = {plain}")


def _glue(name: str, value: float | int | str) -> None:
    """Display a value as myst_nb's ``glue`` does, which needs Jupyter alone to be written, and the book to be read."""
    from IPython.display import display

    record = {"application/papermill.record/text/plain": repr(value)}
    display(record, raw=True, metadata={"scrapbook": {"name": name, "mime_prefix": "application/papermill.record/"}})


_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def scientific(value: float, digits: int = 2) -> str:
    """Return a number for prose, with the given number of significant digits.

    Examples
    --------
    >>> scientific(5.83e-13)
    '5.8·10⁻¹³'
    >>> scientific(1e-6, 1)
    '10⁻⁶'
    >>> scientific(0.0)
    '0'
    """
    if value == 0:
        return "0"
    mantissa, _, exponent = f"{value:.{digits - 1}e}".partition("e")
    power = f"10{str(int(exponent)).translate(_RAISED)}"
    return (power if mantissa == "1" and int(exponent) else f"{mantissa}·{power}").replace("-", "−")


def grouped(digits: str, by: int = 5) -> str:
    """Return a decimal number with a space after every few digits, at which a line may break.

    Examples
    --------
    >>> grouped("-3.27391669925")
    '−3.27391 66992 5'
    """
    whole, point, places = digits.replace("-", "−").partition(".")
    return whole + point + " ".join(places[i : i + by] for i in range(0, len(places), by))


def polynomial_lines(coefficients: Sequence[int], symbol: str, each: int = 2) -> str:
    r"""Return a polynomial as LaTeX with ``each`` terms per line; the coefficients begin with the highest power.

    Examples
    --------
    >>> print(polynomial_lines([2, 0, -5, 3], "x"))
    \begin{aligned}
    &2x^{3} -5x^{1} \\
    &+3
    \end{aligned}
    """
    last = len(coefficients) - 1
    terms = [
        (f"{value:+d}" if i else f"{value}") + (f"{symbol}^{{{last - i}}}" if i < last else "")
        for i, value in enumerate(coefficients)
        if value
    ]
    lines = [" ".join(terms[i : i + each]) for i in range(0, len(terms), each)]
    return "\\begin{aligned}\n" + " \\\\\n".join(f"&{line}" for line in lines) + "\n\\end{aligned}"


def table(rows: Iterable[Mapping[str, object]]) -> Styler:
    """Return rows of named entries as a table for a page."""
    import pandas as pd

    frame = pd.DataFrame(list(rows))
    # pandas would draw the id at random, and two builds of the book would differ.
    id = hashlib.sha256(frame.to_csv().encode()).hexdigest()[:8]
    # The theme styles tables of this class for light and dark pages, and no others.
    return frame.style.hide().set_uuid(id).set_table_attributes('class="dataframe"')


def comparison_table(rows: Iterable[Comparison]) -> Styler:
    """Return comparisons with published data as a table for a page, one row each."""
    return table(
        {
            "signal": readable(row.signal.replace("y_hat", "y^")),
            "samples": row.samples,
            "largest |difference|": number(row.largest),
            "at k": row.at,
            "tolerance": "none" if row.tolerance is None else number(row.tolerance),
            "verdict": row.verdict,
        }
        for row in rows
    )


def judgement_table(judgements: Iterable[Judgement]) -> Styler:
    """Return judgements as a table for a page, one row each: the result, and a case that the check rejects."""
    return table(
        {
            "claim": judgement.claim.id,
            "status": judgement.status,
            "cases": judgement.evidence.cases if judgement.evidence else "",
            "largest violation": number(judgement.evidence.worst) if judgement.evidence else "",
            "tolerance": number(judgement.evidence.tolerance) if judgement.evidence else "",
            "the check rejects": readable(
                judgement.claim.control.what if judgement.claim.control else f"no check: {judgement.claim.reason}"
            ),
        }
        for judgement in judgements
    )


def number(value: float) -> str:
    """Return a number with two digits for a page: 2·10⁻¹² and not 2e-12."""
    # Adding zero turns a negative zero into a plain one.
    digits, _, exponent = f"{value + 0.0:.2g}".partition("e")
    if not exponent:
        return digits.replace("-", "−")
    if 0 < int(exponent) < 4 and digits != "1":
        return str(int(float(digits) * 10 ** int(exponent))).replace("-", "−")
    power = "10" + str(int(exponent)).translate(_RAISED)
    return power if digits == "1" else f"{digits}·{power}".replace("-", "−")


_GREEK = {
    **{"alpha": "α", "beta": "β", "gamma": "γ", "Gamma": "Γ", "delta": "δ", "eps": "ε", "epsilon": "ε", "zeta": "ζ"},
    **{"theta": "θ", "kappa": "κ", "lambda": "λ", "mu": "μ", "nu": "ν", "xi": "ξ", "rho": "ρ", "phi": "φ"},
    **{"omega": "ω", "omegas": "ω"},
}
_SIGNS = {"&lt;=": "≤", "&gt;=": "≥", "!=": "≠", "-&gt;": "→", "|-&gt;": "↦"}


def readable(text: str) -> str:
    """Return the plain text of a claim as HTML with typeset formulas: Greek letters, indices, powers, numbers."""
    text = html.escape(text, quote=False)
    for plain, sign in _SIGNS.items():
        text = text.replace(plain, sign)
    text = re.sub(r"\b(\d+(?:\.\d+)?)e(-?)\+?0*(\d+)\b", lambda m: number(float(m[0])), text)
    text = re.sub(r"\b([a-zA-Z]+)-bar\b", lambda m: _GREEK.get(m[1], m[1]) + "\u0304", text)
    text = re.sub(r"(?<![A-Za-z])(" + "|".join(_GREEK) + r")(?![A-Za-z])", lambda m: _GREEK[m[1]], text)
    text = re.sub(r"(\w)~", "\\1\u0303", text)
    text = re.sub(r"(\w)\^(?=[\s,.;:)]|$)", "\\1\u0302", text)
    index = r"(?:\{[^{}]*\}|\d+|[A-Za-z]+(?:[+-]\d+)?(?!\w))"
    text = re.sub(rf"(?<=[\w\u0303\u0304*])_({index})", lambda m: f"<sub>{_bare(m[1])}</sub>", text)
    power = r"(?:\([^()]*\)|\{[^{}]*\}|-?\w+|\+)"
    text = re.sub(rf"\^({power})", lambda m: f"<sup>{_bare(m[1])}</sup>", text)
    # A transpose, not a quotation mark or a possessive.
    return re.sub(r"(?<=[\w)>\]])'(?=[\w(\[)]|\s?[A-Z(\[])(?!s\b)", "ᵀ", text)


def _bare(script: str) -> str:
    """Return an index or a power without its brackets."""
    if script[0] + script[-1] in ("{}", "()"):
        script = script[1:-1]
    return script.replace("-", "−")
