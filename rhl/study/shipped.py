"""The campaigns whose results come with the library: their configurations and condensed results."""

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
# The number of plants of each campaign that are kept individually, spread over all of them.
_KEPT = 12
# Parts are summarised if there are at most this many schemes.
_FEW = 2


def configuration(name: str) -> str:
    """Return the TOML file of one of the ``CAMPAIGNS``."""
    choice("name", name, CAMPAIGNS)
    return files("rhl").joinpath("study", "data", f"{name}.toml").read_text(encoding="utf-8")


def numbers() -> dict[str, Any]:
    """Return the condensed results of each campaign, in the form of ``condense``."""
    text = files("rhl").joinpath("study", "data", "many_plants.json").read_text(encoding="utf-8")
    found: dict[str, Any] = json.loads(text)
    return found


def condense(results: xr.Dataset) -> dict[str, Any]:
    """Return the condensed results of a campaign as JSON data.

    Parameters
    ----------
    results : xarray.Dataset
        The results of a whole campaign.

    Returns
    -------
    dict
        "all": the ``summary``. "by_name", of benchmarks: their names, and for each scheme whether the runs came to
        rest and their peaks. "by_sampling", of others with several sampling times: summaries of parts. Otherwise, for
        at most two schemes, "by_size": the same with n, p and q, "by_radius": with the lower end ``radius`` of an
        interval of spectral radii (the last has no upper end), and "by_margin": with the lower end ``margin`` of an
        interval of the lesser of the two margins, of plants with a mode that does not decay. "plants": the numbers of
        some plants, and their runs as in "by_name". A peak is None if the run diverged.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> from rhl.study.backends import in_process
    >>> from rhl.study.campaign import Campaign, run, summary
    >>> from rhl.study.choices import Choice
    >>> from rhl.study.ensembles import RandomPlants
    >>> from rhl.study.store import Store
    >>> campaign = Campaign(RandomPlants(seed=1, count=2), (Choice("default"),), steps=40)
    >>> with TemporaryDirectory() as folder:
    ...     store = Store.create(f"{folder}/few", campaign, "", {})
    ...     run(campaign, store, in_process())
    ...     results = store.dataset()
    >>> [(row["scheme"], row["plants"], row["diverged"]) for row in summary(results)]
    [('default', 2, 0.0)]
    >>> [row["plants"] for row in condense(results)["all"]]
    [2]
    """
    found: dict[str, Any] = {"all": summary(results)}
    radius, sampling = results.spectral_radius.values, results.sampling.values
    if "name" in results.coords:
        found["by_name"] = [{"names": [str(name) for name in results.name.values], **row} for row in _each(results)]
    elif len(times := np.unique(sampling)) > 1:
        found["by_sampling"] = _binned(results, "sampling", sampling, times)
    elif results.sizes["scheme"] <= _FEW:
        sizes = np.stack([results[name].values for name in ("n", "p", "q")], axis=1)
        found["by_size"] = [
            {"n": n, "p": p, "q": q, **row}
            for n, p, q in np.unique(sizes, axis=0).tolist()
            for row in summary(results.isel(plant=np.flatnonzero(np.all(sizes == (n, p, q), axis=1))))
        ]
        margin = np.minimum(results.stabilizability_margin.values, results.detectability_margin.values)
        found["by_radius"] = _binned(results, "radius", radius, np.arange(13) / 10)
        found["by_margin"] = _binned(results, "margin", margin, np.array([0, 1e-3, 3e-3, 1e-2, 3e-2, 1e-1]))
    count = int(results.sizes["plant"])
    kept = np.unique(np.linspace(0, count - 1, min(_KEPT, count)).round().astype(int))
    found["plants"] = {"numbers": kept.tolist(), "schemes": _each(results.isel(plant=kept))}
    return _json(found)


def _binned(results: xr.Dataset, name: str, values: np.ndarray, ends: np.ndarray) -> list[dict[str, Any]]:
    """Return summaries of the plants with a finite value between consecutive ends, or above the last one."""
    # Rounding may have decreased a radius that was drawn as 0.8.
    bins = np.searchsorted(ends, values * (1 + 1e-9), side="right") - 1
    members = [np.flatnonzero((bins == i) & np.isfinite(values)) for i in range(len(ends))]
    return [
        {name: float(end), **row}
        for end, those in zip(ends, members, strict=True)
        if len(those)
        for row in summary(results.isel(plant=those))
    ]


def _each(results: xr.Dataset) -> list[dict[str, Any]]:
    return [
        {
            "scheme": str(scheme),
            "at_rest": results.sel(scheme=scheme).at_rest.values.tolist(),
            "peak": results.sel(scheme=scheme).peak.values.tolist(),
        }
        for scheme in results.scheme.values
    ]


def _json(value: Any) -> Any:
    """Return a value with five digits for its numbers, and None for those that are not finite."""
    if isinstance(value, dict):
        return {name: _json(inner) for name, inner in value.items()}
    if isinstance(value, list):
        return [_json(inner) for inner in value]
    if isinstance(value, float):
        return float(f"{value:.5g}") if np.isfinite(value) else None
    return value
