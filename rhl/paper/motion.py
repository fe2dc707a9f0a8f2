"""Mechanical plants that move on the page when a reader asks for it: an arm, a pendulum on its cart."""

from __future__ import annotations

import html
from dataclasses import dataclass

import numpy as np

from rhl._checks import Array

_GHOSTS = 9
_LINK = 70.0
_WIDTH, _HEIGHT, _MARGIN = 360.0, 190.0, 90.0
# Starts every animation of the picture beside the button; nothing moves before.
_PLAY = "this.closest('figure').querySelectorAll('animateTransform').forEach((part) => part.beginElement())"


@dataclass(frozen=True)
class Motion:
    """A drawing that moves once when its button is pressed; without scripts it shows a few positions at once."""

    drawing: str
    alt: str
    caption: str

    def __repr__(self) -> str:
        return self.alt

    def _repr_html_(self) -> str:
        return (
            '<figure class="rhl-figure rhl-motion">'
            f'<svg viewBox="0 0 {_WIDTH:g} {_HEIGHT:g}" role="img" aria-label="{html.escape(self.alt)}" '
            f'style="width:100%;max-width:34rem">{self.drawing}</svg>'
            f'<button type="button" onclick="{_PLAY}">Play</button>'
            f"<figcaption>{html.escape(self.caption)}</figcaption></figure>"
        )


def link(angles: Array, seconds: float, alt: str, caption: str, base: Array | None = None) -> Motion:
    """Return a link that turns about its base, drawn at a few steps and moving over all of them.

    ``angles`` (steps,), rad, is measured from the upright position, clockwise. ``base`` (steps,) is the base's position
    along a rail, in lengths of the link; None for a fixed one. The motion takes ``seconds`` on the page.

    Examples
    --------
    >>> picture = link(np.linspace(0.5, 0.0, 20), 4.0, "A link turns upright.", "A link that turns upright.")
    >>> picture._repr_html_().count("<animateTransform")
    1
    """
    turns = np.degrees(angles)
    along = np.zeros(len(angles)) if base is None else np.asarray(base, dtype=float)
    # The rail fits the picture, however far the base goes.
    reach = max(float(np.ptp(along)) * _LINK, 1e-9)
    scale = min(1.0, (_WIDTH - 2 * _MARGIN) / reach)
    at = _WIDTH / 2 + scale * _LINK * (along - (along.max() + along.min()) / 2)
    rail = f'<line x1="10" x2="{_WIDTH - 10:g}" y1="95" y2="95" stroke="var(--rhl-grid, #c9ccd1)"/>'
    parts = [] if base is None else [rail]
    for k in np.unique(np.linspace(0, len(turns) - 1, _GHOSTS).astype(int)):
        parts.append(f'<g transform="translate({at[k]:.1f} 95)">{_link(turns[k], 0.25)}</g>')
    timing = f'dur="{seconds:g}s" begin="indefinite" fill="freeze" calcMode="linear"'
    turning = f'<animateTransform attributeName="transform" type="rotate" {timing} values="{_values(turns)}"/>'
    body = _link(turns[0], 1.0, turning)
    if base is None:
        return Motion("".join([*parts, f'<g transform="translate({at[0]:.1f} 95)">{body}</g>']), alt, caption)
    moving = f'<animateTransform attributeName="transform" type="translate" {timing} values="{_values(at, " 95")}"/>'
    cart = '<rect x="-22" y="-8" width="44" height="16" fill="var(--rhl-2, #d55e00)"/>'
    whole = f'<g transform="translate({at[0]:.1f} 95)">{moving}{cart}{body}</g>'
    return Motion("".join([*parts, whole]), alt, caption)


def _values(numbers: Array, more: str = "") -> str:
    return ";".join(f"{number:.2f}{more}" for number in numbers)


def _link(turn: float, opacity: float, inside: str = "") -> str:
    return (
        f'<g transform="rotate({turn:.2f})" opacity="{opacity:g}">{inside}'
        f'<line x1="0" y1="0" x2="0" y2="{-_LINK:g}" stroke="var(--rhl-1, #0072b2)" stroke-width="5" '
        f'stroke-linecap="round"/><circle cx="0" cy="{-_LINK:g}" r="7" fill="var(--rhl-1, #0072b2)"/></g>'
    )
