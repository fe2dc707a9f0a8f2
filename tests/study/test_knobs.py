"""Remedies are counted as they are: one that changes nothing mends nothing, and a wrong model does not help."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from rhl import InputError
from rhl.study.ensembles import RandomPlants
from rhl.study.knobs import KNOBS, Plants, outcome, rough, tried

PLANTS = Plants.drawn(RandomPlants(3, 40, n=(3,), radius=(1.0, 1.6)))


def knob(turn):
    (found,) = (one for one in KNOBS if one.turn == turn)
    return found


def test_first_outputs_are_one():
    first = np.abs(np.einsum("...pn,...n->...p", PLANTS.plant.H, PLANTS.z0)).max(axis=-1)
    assert np.allclose(first, 1.0)
    assert len(PLANTS.some(np.arange(40) < 7).z0) == 7


def test_counts_are_those_of_the_runs():
    one = knob("a [rough] model, right to a tenth")
    before = outcome(PLANTS, one.start, 200)
    found = tried(one, PLANTS)
    assert found.plants == 40
    assert found.shown == np.sum(before.peak > 100) > 0
    after = outcome(PLANTS.some(before.peak > 100), one.turned, 200)
    assert found.mended == np.sum(after.peak <= 100)
    assert found.ratio < 1


def test_a_run_that_ends_at_once_has_no_peak(monkeypatch):
    ended = SimpleNamespace(y=np.ones((30, 3, 1)), diverged_at=np.array([0, 7, -1]))
    monkeypatch.setattr("rhl.study.knobs.simulate", lambda *given, **named: ended)
    assert outcome(PLANTS, KNOBS[0].start, 30).peak.tolist() == [np.inf, np.inf, 1.0]


def test_a_remedy_that_changes_nothing_mends_nothing():
    one = knob("input_size = 0.01")
    found = tried(replace(one, turned=one.start), PLANTS)
    assert (found.mended, found.lower, found.ratio) == (0, 0, 1.0)
    assert found.shown > 0


def test_a_wrong_model_is_worse_than_a_right_one():
    right, wrong = (tried(replace(KNOBS[2], turned=rough(error)), PLANTS) for error in (0.01, 1.0))
    assert right.ratio < 0.5 < wrong.ratio


def test_plants_without_the_symptom_count_none():
    slow = Plants.drawn(RandomPlants(3, 10, n=(2,), radius=(0.3, 0.5)))
    found = tried(knob("a [rough] model, right to a tenth"), slow)
    assert (found.plants, found.shown, found.mended, found.ratio) == (10, 0, 0, 1.0)


def test_bad_input():
    with pytest.raises(InputError, match="knob must be a Knob, got 1"):
        tried(1, PLANTS)
    with pytest.raises(InputError, match="steps must be an integer of at least 20, got 3"):
        tried(KNOBS[0], PLANTS, steps=3)
