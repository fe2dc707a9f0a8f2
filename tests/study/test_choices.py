"""Each setting of a choice arrives in its scheme, and nothing else changes."""

import numpy as np
import pytest

from rhl import InputError
from rhl.study.choices import Choice


@pytest.mark.parametrize(
    ("settings", "check"),
    [
        ({"R": 0.5}, lambda scheme: scheme.controller.R == 0.5),
        ({"eps_rate": 7.0}, lambda scheme: scheme.controller.epsilon(1) == 1 / 64),
        ({"horizon": 9}, lambda scheme: scheme.controller.horizon == 9),
        ({"model_delay": 1}, lambda scheme: scheme.controller.model_delay == 1),
        ({"weight": 0.25}, lambda scheme: scheme.estimator.weight == 0.25),
        ({"inputs": 3.0}, lambda scheme: scheme.units.inputs == 3.0),
        ({"units": False}, lambda scheme: scheme.units is None),
        ({"units": False, "memory": "window", "window": 1.5}, lambda scheme: scheme.estimator.window == 5),
        ({"base": "window", "weight": 0.25}, lambda scheme: scheme.estimator.generator.weight == 0.25),
        ({"base": "window", "window": 1.0}, lambda scheme: scheme.estimator.window == 3),
        ({"base": "window", "memory": "growing"}, lambda scheme: getattr(scheme.estimator, "weight", None) == 0.01),
        ({"order_factor": 1.5}, lambda scheme: scheme.lifting.outputs == 5),
    ],
)
def test_each_setting_arrives_and_nothing_else_changes(settings, check):
    changed = Choice("a", **settings).scheme(2, 1, 3)
    plain = Choice("a", settings.get("base", "default")).scheme(2, 1, 3)
    assert check(changed)
    assert not check(plain)
    if "order_factor" not in settings:
        assert np.array_equal(changed.initial_model.B, plain.initial_model.B)
        changing = settings.keys() | ({"epsilon"} if "eps_rate" in settings else set())
        kept = {"Q", "R", "horizon", "model_delay", "epsilon"} - changing
        assert all(getattr(changed.controller, name) == getattr(plain.controller, name) for name in kept)


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"order_factor": 0.5}, "order_factor must be a number from 1 to 100, got 0.5"),
        ({"base": "other"}, "base must be one of default, window, got 'other'"),
        ({"R": -1.0}, "R must be a positive finite number, got -1.0"),
        ({"base": "window", "units": True}, 'units must be left out where base is "window", got True'),
        ({"base": "window", "inputs": 1.0}, 'inputs must be left out where base is "window", got 1.0'),
        ({"units": False, "inputs": 1.0}, "inputs must be left out where units is false, got 1"),
        ({"base": "window", "window": 1e308}, r"window must be at most 100000, got 1e\+308"),
        ({"window": 2.0}, "window must be left out where every transition is kept, got 2"),
    ],
)
def test_choices_that_are_refused(settings, sentence):
    with pytest.raises(InputError, match=sentence):
        Choice("a", **settings)
