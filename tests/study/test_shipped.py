"""The numbers that come with the library are those that their configurations give."""

import json
import tomllib
from importlib.resources import files

import numpy as np
import pytest

from rhl import InputError
from rhl.app._campaign_keys import parse
from rhl.study import shipped
from rhl.study.backends import in_process
from rhl.study.campaign import Campaign, run
from rhl.study.choices import Choice
from rhl.study.ensembles import RandomPlants
from rhl.study.shipped import CAMPAIGNS, condense, configuration, numbers
from tests.sizes import size

# Numbers are kept with five digits. On another kind of processor a sum may be rounded otherwise, which a run enlarges
# until the estimate has settled; so runs with a high peak, and one in ten others, are compared by their outcome only.
_RTOL, _HIGH = 1e-3, 1e3


def campaign(name):
    return parse(tomllib.loads(configuration(name))).campaign()


def kept(name, label):
    found = numbers()[name]["plants"]
    row = next(row for row in found["schemes"] if row["scheme"] == label)
    peak = np.array([np.inf if value is None else value for value in row["peak"]])
    return np.array(found["numbers"]), np.array(row["at_rest"]), peak


def agrees(of, scheme, numbers_, at_rest, peak):
    found = of.runs(scheme, numbers_.tolist())
    low = (peak < _HIGH) | (found["peak"] < _HIGH)
    apart = ~np.isclose(found["peak"], peak, rtol=_RTOL) & low
    return np.array_equal(found["at_rest"], at_rest) and np.sum(apart) <= 0.1 * len(peak)


def test_every_configuration_is_read_and_kept():
    assert list(numbers()) == list(CAMPAIGNS)
    for name in CAMPAIGNS:
        labels = [one.label for one in campaign(name).schemes]
        assert [row["scheme"] for row in numbers()[name]["all"]] == labels
        assert {row["plants"] for row in numbers()[name]["all"]} == {len(campaign(name).plants)}
    with pytest.raises(InputError, match="name must be one of random, settings, "):
        configuration("rnadom")


def test_they_are_small():
    data = files("rhl").joinpath("study", "data")
    assert sum(len(file.read_bytes()) for file in data.iterdir() if file.name != "comparison.csv") < 100_000


@pytest.mark.parametrize("scheme", [0, 1])
def test_random_plants(scheme):
    of = campaign("random")
    numbers_, at_rest, peak = kept("random", of.schemes[scheme].label)
    assert len(numbers_) == shipped._KEPT == 12
    some = slice(size(4, 12))
    numbers_, at_rest, peak = numbers_[some], at_rest[some], peak[some]
    assert agrees(of, scheme, numbers_, at_rest, peak)
    other = Campaign(RandomPlants(2, of.plants.count, of.plants.n, (1, 2), (1, 2), conditioning=10.0), of.schemes)
    assert not agrees(other, scheme, numbers_, at_rest, peak)


@pytest.mark.parametrize("name", [name for name in CAMPAIGNS if name != "random"])
def test_the_other_campaigns(name):
    of = campaign(name)
    numbers_, at_rest, peak = kept(name, of.schemes[0].label)
    some = slice(None, None, size(12, 4))
    assert agrees(of, 0, numbers_[some], at_rest[some], peak[some])
    assert not agrees(of, 0, numbers_[some], at_rest[some], 1.01 * peak[some])


def test_parts_are_parts():
    found = numbers()["random"]
    for part in ("by_size", "by_radius"):
        for row in found["all"]:
            those = [one for one in found[part] if one["scheme"] == row["scheme"]]
            assert sum(one["plants"] for one in those) == row["plants"]
            at_rest = sum(one["plants"] * one["at_rest"] for one in those)
            assert np.isclose(at_rest, row["plants"] * row["at_rest"], rtol=1e-4)


def test_condense():
    xr = pytest.importorskip("xarray")
    plants = RandomPlants(1, 3, n=(2,), p=(1, 2), radius=(0.8, 0.8))
    of = Campaign(plants, (Choice("d"),), steps=20)
    found = {}

    class Kept:
        def done(self):
            return set()

        def write(self, task, values):
            for name, of_each in values.items():
                found[name] = ("plant", of_each) if task.scheme is None else (("scheme", "plant"), of_each[None])

    run(of, Kept(), in_process())
    whole = condense(xr.Dataset(found, {"scheme": ["d"], "plant": range(6)}))
    assert [(row["n"], row["p"], row["plants"]) for row in whole["by_size"]] == [(2, 1, 3), (2, 2, 3)]
    assert [(row["radius"], row["plants"]) for row in whole["by_radius"]] == [(0.8, 6)]
    assert whole["by_margin"] == []  # every mode decays
    assert whole["plants"]["numbers"] == list(range(6))
    assert json.loads(json.dumps(whole, allow_nan=False)) == whole
