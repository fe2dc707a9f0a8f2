"""The scheme in the loop with hardware: the same inputs as in a simulation, after a restore and after bad input too."""

import io
import struct
import tracemalloc
from contextlib import suppress
from dataclasses import replace
from zipfile import ZIP_BZIP2, ZIP_DEFLATED, ZIP_LZMA, ZIP_STORED, ZipFile

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
    simulate,
    window_scheme,
)
from rhl.basis import Polynomials
from rhl.family import ModelFamily
from rhl.paper.claims.theorem_4 import family_scheme
from rhl.paper.published import linear_example
from tests.sizes import size

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


def saved(path, scheme=SCHEMES[1], steps=3):
    """The arrays of a saved state."""
    controller = LiveController(scheme)
    for _ in range(steps):
        controller.step([1.0])
    controller.save(path)
    with np.load(path) as file:
        return dict(file)


def packed(path, arrays, method=ZIP_STORED, offset=None):
    """Write an archive of arrays, or of the bytes of their files."""
    with ZipFile(path, "w", method) as archive:
        for name, array in arrays.items():
            if not isinstance(array, bytes):
                buffer = io.BytesIO()
                np.save(buffer, array)
                array = buffer.getvalue()
            archive.writestr(f"{name}.npy", array)
        for entry in archive.filelist:
            entry.header_offset = entry.header_offset if offset is None else offset


def array_file(shape, kind="<f8"):
    header = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}".encode()
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header) + 1) + header + b"\n"


def refused(path, scheme=SCHEMES[1]):
    """The sentence that refuses a file, and the most memory that this took."""
    tracemalloc.start()
    try:
        with pytest.raises(InputError) as caught:
            LiveController.restore(scheme, path)
        return str(caught.value), tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_a_large_file_is_not_read(tmp_path):
    path = tmp_path / "state.npz"
    with path.open("wb") as file:
        file.truncate(10**12)  # a hole: a terabyte that takes no room on the disk
    said, most = refused(path)
    assert said.endswith(
        "state.npz must be a saved state of at most 10328 bytes, as the scheme's is, got more; give the scheme that "
        "was running then"
    )
    assert most < 1_000_000


def test_a_small_file_that_unpacks_to_much_is_not_unpacked(tmp_path):
    path, kept = tmp_path / "state.npz", saved(tmp_path / "state.npz")
    np.savez_compressed(path, **(kept | {"y": np.zeros(800_000)}))
    assert path.stat().st_size < 9_000
    said, most = refused(path)
    assert said.endswith("must be a saved state, got: a file that LiveController.save did not write")
    assert most < 1_000_000
    content = bytearray(path.read_bytes())
    begin = content.rindex(b"PK\x01\x02", 0, content.rindex(b"\0y.npy"))
    assert content[begin + 24 : begin + 28] == struct.pack("<I", 6_400_128)
    content[begin + 24 : begin + 28] = struct.pack("<I", 160)  # the archive understates the size
    path.write_bytes(content)
    said, most = refused(path)
    assert said.endswith("must be a saved state, got: a file that LiveController.save did not write")
    assert most < 1_000_000
    np.savez_compressed(path, **kept)  # the control: packing as such is no fault
    assert LiveController.restore(SCHEMES[1], path).state.k == 3


@pytest.mark.parametrize(
    "change",
    [
        {"A": array_file((10**13,))},
        {"A": array_file((10**9,))},
        {"A": array_file((2**64,))},
        {"A": array_file((0, 10**21))},
        {"A": array_file((0, 2))},
        {"A": array_file((10**12,), "|V0")},
        {"A": array_file((-1, 4))},
        {"A": array_file((2, 2), "|O")},
        {"A": array_file("(" * 900 + ")" * 900)},
        {"A": array_file("(9**9**9,)")},
        {"k": b"hello"},
        {"family": b""},
        {"extra": np.zeros(1)},
        {"v": None},
        {"k": None},
        {"k": np.bool_(True)},
        {"stage": np.float64(1e300)},
        {"stage": np.zeros((7, 3), dtype=int)},
        {"y": np.full((4, 1), np.nan)},
    ],
)
def test_arrays_that_save_does_not_write(tmp_path, change):
    path = tmp_path / "state.npz"
    arrays = saved(path) | change
    packed(path, {name: array for name, array in arrays.items() if array is not None})
    said, most = refused(path)
    assert said.endswith("must be a saved state, got: a file that LiveController.save did not write")
    assert most < 1_000_000


@pytest.mark.parametrize("method", [ZIP_STORED, ZIP_DEFLATED, ZIP_BZIP2, ZIP_LZMA])
def test_archives_that_are_damaged_or_packed_otherwise(tmp_path, method):
    path = tmp_path / "state.npz"
    kept, ours = saved(path), method in (ZIP_STORED, ZIP_DEFLATED)
    packed(path, kept, method)
    content = path.read_bytes()
    if ours:
        assert LiveController.restore(SCHEMES[1], path).state.k == 3
    else:
        assert refused(path)[0].endswith("got: a file that LiveController.save did not write")
    at = content.index(b"A.npy") + 5
    first, second = content.index(b"PK\x03\x04"), content.index(b"PK\x01\x02")
    for begin, wrong in (
        (at, bytes(byte ^ 0xFF for byte in content[at : at + 40])),
        (second + 8, b"\x01\x00"),  # encrypted
        (second + 10, b"\x63\x00"),  # no such method
        (second + 6, b"\xff\x00"),  # no such version
        (first, b"none"),
        (len(content) - 30, b""),
    ):
        path.write_bytes(content[:begin] + wrong + (content[begin + len(wrong) :] if wrong else b""))
        assert refused(path)[0].endswith("got: a file that LiveController.save did not write")
    packed(path, kept, method, offset=2**64 - 1)
    assert refused(path)[0].endswith("got: a file that LiveController.save did not write")


def test_no_damage_is_an_error_of_another_kind(tmp_path):
    path, random = tmp_path / "state.npz", np.random.default_rng(0)
    saved(path)
    content, restored = path.read_bytes(), 0
    for _ in range(size(300, 20_000)):
        damaged = bytearray(content)
        for at in random.integers(len(content), size=random.integers(1, 5)):
            damaged[at] = random.integers(256)
        path.write_bytes(damaged)
        with suppress(InputError):
            LiveController.restore(SCHEMES[1], path)
            restored += 1
    assert restored < size(300, 20_000) / 2


@pytest.mark.parametrize(
    ("scheme", "change", "says"),
    [
        (
            1,
            {"k": np.uint64(2**64 - 1)},
            "the state's k must be at most 9007199254740992, got 18446744073709551615; give",
        ),
        (
            1,
            {"stage": np.int64(0)},
            "state must belong to the scheme, whose stage is None, got one that has shape (); give",
        ),
        (
            1,
            {"value": np.zeros(9)},
            "state must belong to the scheme, whose value is None, got one that has shape (9,)",
        ),
        (1, {"size": np.array([-1.0])}, "the state's size must be of at least 0, got array([-1.]); give a state that"),
        (
            1,
            {"data": np.ones((4, 6))},
            "the state's data must be triangular, with a diagonal of at least 0, got array(",
        ),
        (1, {"data": -np.eye(4, 6)}, "the state's data must be triangular, with a diagonal of at least 0, got array("),
        (1, {"size": None}, "state must belong to the scheme, whose size has shape (1,), got one that is None; give"),
        (2, {"stage": None}, "state must belong to the scheme, whose stage has shape (), got one that is None; give"),
        (2, {"value": None}, "state must belong to the scheme, whose value has shape (), got one that is None; give"),
        (
            2,
            {"value": np.zeros(9)},
            "state must belong to the scheme, whose value has shape (), got one that has shape (9,)",
        ),
        (
            2,
            {"stage": np.int64(3)},
            "the state's stage must be from 0 to 2, got array(3); give a state that the scheme",
        ),
        (
            2,
            {"stage": np.int64(-1)},
            "the state's stage must be from 0 to 2, got array(-1); give a state that the scheme",
        ),
    ],
)
def test_numbers_that_no_step_returns(tmp_path, scheme, change, says):
    path = tmp_path / "state.npz"
    kept = saved(path, SCHEMES[scheme])
    assert LiveController.restore(SCHEMES[scheme], path).step([1.0]).shape == (1,)
    np.savez(path, **{name: array for name, array in (kept | change).items() if array is not None})
    assert refused(path, SCHEMES[scheme])[0].startswith(says)


def test_a_state_of_infinite_data_is_refused():
    controller = LiveController(SCHEMES[1])
    controller.step([1.0])
    assert LiveController(SCHEMES[1], controller.state).state is controller.state
    with pytest.raises(InputError, match="the state's data must be finite, got inf among its entries"):
        LiveController(SCHEMES[1], replace(controller.state, data=np.full((4, 6), np.inf)))
    with pytest.raises(InputError, match=r"the state's k must be an integer of at least 0, got 1\.5"):
        LiveController(SCHEMES[1], replace(controller.state, k=1.5))


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
