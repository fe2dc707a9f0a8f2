"""What the book's pages share: numbers for the prose, tables of comparisons."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

from rhl._checks import InputError
from rhl.published import Comparison

if TYPE_CHECKING:
    from pandas.io.formats.style import Styler


def tell(**values: float | int | str) -> None:
    """Hand numbers, or short texts, to the prose of the page under their names.

    Parameters
    ----------
    **values : float, int or str
        Read in the text as ``{glue:text}`name:.2f```.

    Raises
    ------
    InputError
        If a number is not finite: no page shall say NaN.
    """
    from myst_nb import glue  # here, because only the book's extra installs it

    for name, value in values.items():
        plain = value if isinstance(value, str) else value.item() if hasattr(value, "item") else value
        if not isinstance(plain, str) and not math.isfinite(plain):
            raise InputError(f"{name} must be finite to be told in the text, got {plain}")
        glue(name, plain, display=False)


def table(rows: Iterable[Mapping[str, object]]) -> Styler:
    """Return rows of named entries as a table for a page."""
    import pandas as pd

    # The theme styles tables of this class for light and dark pages, and no others.
    return pd.DataFrame(list(rows)).style.hide().set_table_attributes('class="dataframe"')


def comparison_table(rows: Iterable[Comparison]) -> Styler:
    """Return comparisons with published data as a table for a page, one row each."""
    return table(
        {
            "signal": row.signal,
            "samples": row.samples,
            "largest |difference|": f"{row.largest:.2g}",
            "at k": row.at,
            "tolerance": "none" if row.tolerance is None else f"{row.tolerance:g}",
            "verdict": row.verdict,
        }
        for row in rows
    )
