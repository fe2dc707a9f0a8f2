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
_KEPT = 16


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
        "all": the ``summary``. "by_size", "by_radius", "by_sampling": summaries of parts, with n, p and q, with the
        lower end ``radius`` of an interval of spectral radii, and with the sampling time. "by_name": for benchmarks,
        whether each run came to rest, and its peak. "plants": the numbers of some plants, and under each scheme whether
        they came to rest and their peaks. A peak is None where the run diverged.
    """
    found: dict[str, Any] = {"all": summary(results), "by_size": [], "by_radius": [], "by_sampling": [], "by_name": []}
    sizes = np.stack([results[name].values for name in ("n", "p", "q")], axis=1)
    if "name" in results.coords:
        for i, name in enumerate(results.name.values):
            found["by_name"] += [{"name": str(name), **row} for row in _one_by_one(results.isel(plant=[i]))]
    else:
        for n, p, q in np.unique(sizes, axis=0).tolist():
            part = results.isel(plant=np.flatnonzero(np.all(sizes == (n, p, q), axis=1)))
            found["by_size"] += [{"n": n, "p": p, "q": q, **row} for row in summary(part)]
        for name, unit in (("spectral_radius", 0.1), ("sampling", None)):
            values = results[name].values
            # Tenths are not exact; a radius of 0.8 may be a hair below.
            bins = values if unit is None else np.round(np.floor(values / unit + 1e-9) * unit, 9)
            for value in np.unique(bins).tolist():
                part = results.isel(plant=np.flatnonzero(bins == value))
                label = "radius" if name == "spectral_radius" else name
                found[f"by_{label}"] += [{label: value, **row} for row in summary(part)]
    count = int(results.sizes["plant"])
    kept = np.unique(np.linspace(0, count - 1, min(_KEPT, count)).round().astype(int))
    found["plants"] = {"numbers": kept.tolist(), "schemes": _one_by_one(results.isel(plant=kept))}
    return _json(found)


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
