"""The campaigns whose results come with the library: their configurations, and what is kept of what came out."""

from __future__ import annotations

import json
from importlib.resources import files
from typing import TYPE_CHECKING, Any

import numpy as np

from rhl._checks import choice
from rhl.study.campaign import summary

if TYPE_CHECKING:
    import xarray as xr

CAMPAIGNS = ("random", "settings", "units", "hidden", "noise", "bounded", "sampled", "benchmarks")
# So many plants of each campaign are kept one by one, spread over all of them.
_KEPT = 12
# Parts are summed up where there are no more schemes than these.
_FEW = 4


def configuration(name: str) -> str:
    """Return the TOML file of one of the ``CAMPAIGNS``."""
    choice("name", name, CAMPAIGNS)
    return files("rhl").joinpath("study", "data", f"{name}.toml").read_text(encoding="utf-8")


def numbers() -> dict[str, Any]:
    """Return what came out, by campaign, each as ``condense`` returns it."""
    text = files("rhl").joinpath("study", "data", "many_plants.json").read_text(encoding="utf-8")
    found: dict[str, Any] = json.loads(text)
    return found


def condense(results: xr.Dataset) -> dict[str, Any]:
    """Return the few numbers that are kept of a campaign, as JSON can hold them.

    Parameters
    ----------
    results : xarray.Dataset
        A whole campaign's.

    Returns
    -------
    dict
        "all": the ``summary``. "by_size", "by_radius", "by_margin", "by_sampling": summaries of parts, with n, p and q,
        with the lower end ``radius`` of an interval of spectral radii, with the lower end ``margin`` of an interval of
        the lesser of the two margins (of plants with a mode that does not decay), and with the sampling time.
        "by_name": for benchmarks, whether each run came to rest, and its peak. "plants": the numbers of some plants,
        and under each scheme whether they came to rest and their peaks. Parts are empty where there are more
        than four schemes. A peak is None where the run diverged.
    """
    parts = ("size", "radius", "margin", "sampling", "name")
    found: dict[str, Any] = {"all": summary(results), **{f"by_{part}": [] for part in parts}}
    if "name" in results.coords:
        for i, name in enumerate(results.name.values):
            found["by_name"] += [{"name": str(name), **row} for row in _one_by_one(results.isel(plant=[i]))]
    elif results.sizes["scheme"] <= _FEW:
        sizes = np.stack([results[name].values for name in ("n", "p", "q")], axis=1)
        for n, p, q in np.unique(sizes, axis=0).tolist():
            part = results.isel(plant=np.flatnonzero(np.all(sizes == (n, p, q), axis=1)))
            found["by_size"] += [{"n": n, "p": p, "q": q, **row} for row in summary(part)]
        margin = np.minimum(results.stabilizability_margin.values, results.detectability_margin.values)
        radius, sampling = results.spectral_radius.values, results.sampling.values
        found["by_radius"] = _binned(results, "radius", radius, np.arange(0, radius.max() + 0.1, 0.1).round(9))
        found["by_margin"] = _binned(results, "margin", margin, np.array([0, 1e-3, 3e-3, 1e-2, 3e-2, 1e-1]))
        found["by_sampling"] = _binned(results, "sampling", sampling, np.unique(sampling))
    count = int(results.sizes["plant"])
    kept = np.unique(np.linspace(0, count - 1, min(_KEPT, count)).round().astype(int))
    found["plants"] = {"numbers": kept.tolist(), "schemes": _one_by_one(results.isel(plant=kept))}
    return _json(found)


def _binned(results: xr.Dataset, name: str, values: np.ndarray, ends: np.ndarray) -> list[dict[str, Any]]:
    """Return summaries of the plants whose finite value lies from one end to the next."""
    # A radius that was drawn as 0.8 may have become a hair less.
    bins = np.searchsorted(ends, values * (1 + 1e-9), side="right") - 1
    members = [np.flatnonzero((bins == i) & np.isfinite(values)) for i in range(len(ends))]
    return [
        {name: float(end), **row}
        for end, those in zip(ends, members, strict=True)
        if len(those)
        for row in summary(results.isel(plant=those))
    ]


def _one_by_one(results: xr.Dataset) -> list[dict[str, Any]]:
    return [
        {
            "scheme": str(scheme),
            "at_rest": results.sel(scheme=scheme).at_rest.values.tolist(),
            "peak": results.sel(scheme=scheme).peak.values.tolist(),
        }
        for scheme in results.scheme.values
    ]


def _json(value: Any) -> Any:
    """Return a value with six digits for its numbers, and None for those that are not finite."""
    if isinstance(value, dict):
        return {name: _json(inner) for name, inner in value.items()}
    if isinstance(value, list):
        return [_json(inner) for inner in value]
    if isinstance(value, float):
        return float(f"{value:.6g}") if np.isfinite(value) else None
    return value
