"""The scheme in the loop with hardware: the same inputs as in a simulation, after a restore and after bad input too."""

from dataclasses import replace

import numpy as np
import pytest

from rhl import (
    ControllerState,
    InputError,
    LinearPlant,
    LiveController,
    Saturation,
    SignalModel,
    default_scheme,
    live,
    simulate,
    window_scheme,
)
from rhl.basis import Polynomials
from rhl.family import ModelFamily
from rhl.paper.claims.theorem_4 import family_scheme
from rhl.paper.published import linear_example

PLANT = LinearPlant([[1.1, 1.0], [0.0, 0.9]], [[0.0], [1.0]], [[1.0, 0.0]])
Z0 = np.array([1.0, -1.0])
ADAPTIVE = replace(window_scheme(1, 1, 2), controller=replace(window_scheme(1, 1, 2).controller, adaptive=True))
SCHEMES = [window_scheme(1, 1, 2), default_scheme(1, 1, 2), ADAPTIVE]


def driven(controller, z, steps, actuator=lambda v: v, applied=None):
    """Close the loop by hand; the inputs applied, the state, and the input applied last."""
    inputs = []
    for _ in range(steps):
        v = actuator(controller.step(PLANT.output(z), applied))
        applied = v
        inputs.append(v)
        z = PLANT.step(z, v)
    return np.array(inputs), z, applied


@pytest.mark.parametrize("scheme", SCHEMES)
def test_inputs_are_those_of_a_simulation(scheme):
    inputs, _, _ = driven(LiveController(scheme), Z0, 40)
    expected = simulate(scheme, PLANT, Z0, 40).v
    assert np.abs(inputs - expected).max() < 1e-9 * np.abs(expected).max()


def test_published_inputs():
    example = linear_example()
    controller, z = LiveController(example.scheme), example.z0
    for expected in example.run().v[:12]:
        v = controller.step(example.plant.output(z))
        assert np.abs(v - expected).max() < 1e-9
        z = example.plant.step(z, v)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_saved_and_restored_in_mid_run(scheme, tmp_path):
    inputs, _, _ = driven(LiveController(scheme), Z0, 20)
    controller = LiveController(scheme)
    first, z, last = driven(controller, Z0, 9)
    controller.save(tmp_path / "state.npz")
    again = LiveController.restore(scheme, tmp_path / "state.npz")
    second, _, _ = driven(again, z, 11, applied=last)
    assert np.array_equal(np.concatenate([first, second]), inputs)
    # The control: a controller that begins anew goes another way.
    anew, _, _ = driven(LiveController(scheme), z, 11)
    assert not np.allclose(anew, second)


def test_what_the_actuator_let_through_is_remembered():
    scheme, clip = default_scheme(1, 1, 2), Saturation(-0.7, 0.7)
    expected = simulate(scheme, PLANT, Z0, 25, actuator=clip).v
    inputs, _, _ = driven(LiveController(scheme), Z0, 25, actuator=lambda v: clip(0, v))
    assert np.abs(inputs).max() == 0.7
    assert np.abs(inputs - expected).max() < 1e-9
    controller, z, untold = LiveController(scheme), Z0, []
    for _ in range(25):
        untold.append(clip(0, controller.step(PLANT.output(z))))
        z = PLANT.step(z, untold[-1])
    assert np.abs(np.array(untold) - expected).max() > 1e-3


def test_a_bad_measurement_changes_nothing():
    controller = LiveController(default_scheme(1, 1, 2))
    controller.step([1.0])
    before = controller.state
    for y in ([np.nan], [1.0, 2.0], 1.0, "1", [[1.0]]):
        with pytest.raises(InputError, match="y must"):
            controller.step(y)
        assert controller.state is before
    with pytest.raises(InputError, match="applied must have shape"):
        controller.step([1.0], applied=[1.0, 2.0])
    with pytest.raises(InputError, match="applied must be left out at k = 0"):
        LiveController(default_scheme(1, 1, 2)).step([1.0], applied=[0.0])
    assert repr(controller) == "LiveController(k = 1, p = 1, q = 1)"


def test_bad_files(tmp_path):
    scheme, path = default_scheme(1, 1, 2), tmp_path / "state.npz"
    with pytest.raises(InputError, match="must be a saved state, got: No such file"):
        LiveController.restore(scheme, path)
    for content in (b"", b"PK", b"k = 1", np.arange(3).tobytes()):
        path.write_bytes(content)
        with pytest.raises(
            InputError, match=r"must be a saved state, got: a file that LiveController\.save did not write"
        ):
            LiveController.restore(scheme, path)
    np.savez(path, k=np.array([{}], dtype=object))
    with pytest.raises(InputError, match="must be a saved state"):
        LiveController.restore(scheme, path)
    controller = LiveController(scheme)
    controller.step([1.0])
    controller.save(path)
    for other in (default_scheme(1, 1, 3), default_scheme(2, 1, 2), window_scheme(1, 1, 2)):
        with pytest.raises(InputError, match="state must belong to the scheme"):
            LiveController.restore(other, path)
    with pytest.raises(InputError, match="must be a writable file"):
        controller.save(tmp_path)


def test_bad_parts():
    batch = SignalModel(np.ones((3, 2, 2)), np.ones((3, 2, 2)))
    with pytest.raises(InputError, match=r"scheme must be of one loop, got a batch of initial models of shape \(3,\)"):
        LiveController(replace(SCHEMES[0], initial_model=batch))
    with pytest.raises(InputError, match="scheme must be a Scheme"):
        LiveController("scheme")
    with pytest.raises(InputError, match="state must be a ControllerState"):
        LiveController(SCHEMES[0], 1)
    state = ControllerState(0, np.zeros((2, 1)), np.zeros((2, 1)), SignalModel([[1.0]], [[1.0]]))
    with pytest.raises(InputError, match="whose y has shape"):
        LiveController(SCHEMES[0], state)


@pytest.mark.parametrize("k", [2.7, -1, np.array([1]), "1"])
def test_a_saved_step_is_an_integer(tmp_path, k):
    scheme, path = default_scheme(1, 1, 2), tmp_path / "state.npz"
    controller = LiveController(scheme)
    controller.save(path)
    with np.load(path) as file:
        kept = dict(file)
    np.savez(path, **(kept | {"k": k}))
    with pytest.raises(InputError, match="must be a saved state, got: a file that"):
        LiveController.restore(scheme, path)
    np.savez(path, **kept)
    assert LiveController.restore(scheme, path).state.k == 0


def test_a_state_of_another_family_is_refused(tmp_path):
    scheme, path = family_scheme(1, 1, 2), tmp_path / "state.npz"
    controller = LiveController(scheme)
    controller.step([1.0])
    controller.save(path)
    family = scheme.family
    others = ModelFamily(2.0 * family.shifts, family.hysteresis), replace(family, hysteresis=0.5), None
    for other in others:
        with pytest.raises(InputError, match="must be saved with the scheme's family of initial models, got another"):
            LiveController.restore(replace(scheme, family=other), path)
    assert LiveController.restore(scheme, path).state.k == 1


def test_a_small_file_that_unpacks_to_more_than_memory_is_refused(tmp_path, monkeypatch):
    scheme, path = default_scheme(1, 1, 2), tmp_path / "state.npz"
    controller = LiveController(scheme)
    controller.save(path)
    with np.load(path) as file:
        kept = dict(file)
    np.savez_compressed(path, **(kept | {"y": np.zeros(100_000)}))
    monkeypatch.setattr(live, "_LARGEST", 700_000)
    assert path.stat().st_size < 20_000
    # np.load would read it; the control shows that the refusal is that of the unpacked size.
    monkeypatch.setattr(np, "load", lambda *_, **__: pytest.fail("the file is unpacked"))
    with pytest.raises(InputError, match="must be a saved state"):
        LiveController.restore(scheme, path)
    np.savez(path, **kept)
    with pytest.raises(pytest.fail.Exception):
        LiveController.restore(scheme, path)


def test_a_state_of_another_model_is_refused(tmp_path):
    """The same histories, but a signal with more entries."""
    plain = window_scheme(1, 1, 2)
    lifting = replace(plain.lifting, basis=Polynomials(2))
    n, m = lifting.size(1), plain.initial_model.B.shape[1]
    model = SignalModel(np.eye(n), np.zeros((n, m)))
    wide = replace(plain, lifting=lifting, initial_model=model)
    controller = LiveController(wide)
    controller.step([1.0])
    controller.save(tmp_path / "state.npz")
    with pytest.raises(InputError, match="state must belong to the scheme, whose A has shape"):
        LiveController.restore(plain, tmp_path / "state.npz")
