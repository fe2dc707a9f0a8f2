"""A folder of results: described, resumed bit for bit, refused where it is another's, honest where the disk is full."""

import errno
import json
from dataclasses import replace

import numpy as np
import pytest

from rhl import InputError
from rhl.study import store as stores
from rhl.study.backends import in_process
from rhl.study.campaign import PLANT_VARIABLES, RUN_VARIABLES, Campaign, run
from rhl.study.choices import Choice
from rhl.study.ensembles import BenchmarkPlants, RandomPlants
from rhl.study.store import Store, StoreError, load

xr = pytest.importorskip("xarray")
pytest.importorskip("zarr")

CAMPAIGN = Campaign(RandomPlants(1, 10, n=(2, 3)), (Choice("d"), Choice("w", "window")), steps=20, chunk=7)
SETTINGS = {"seed": 1, "schemes": [{"base": "default"}, {"base": "window"}]}


@pytest.fixture
def made(tmp_path):
    return Store.create(tmp_path / "a", CAMPAIGN, "seed = 1", SETTINGS)


@pytest.fixture(scope="module")
def digest(tmp_path_factory):
    """The hash of the campaign without an interruption, in one chunk."""
    whole = replace(CAMPAIGN, chunk=100)
    store = Store.create(tmp_path_factory.mktemp("whole") / "a", whole, "", {})
    run(whole, store, in_process())
    return store.digest()


class Stopped(Exception):
    """The campaign ends here."""


def stopping(store, after):
    """Write that many tasks."""
    left = iter(range(after))

    class Stops:
        def done(self):
            return store.done()

        def write(self, task, found):
            if next(left, None) is None:
                raise Stopped
            store.write(task, found)

    with pytest.raises(Stopped):
        run(CAMPAIGN, Stops(), in_process())


def test_what_is_kept(made):
    run(CAMPAIGN, made, in_process())
    with xr.open_zarr(made.path / "results.zarr") as found:
        assert dict(found.sizes) == {"scheme": 2, "plant": 20}
        assert found.scheme.values.tolist() == ["d", "w"]
        assert found.peak.dims == ("scheme", "plant")
        assert found.peak.chunks == ((1, 1), (7, 7, 6))
        assert found.n.chunks == ((7, 7, 6),)
        assert set(found.data_vars) == {*PLANT_VARIABLES, *RUN_VARIABLES}
        assert all(variable.units and variable.description for variable in found.data_vars.values())
        assert found.attrs["configuration"] == "seed = 1"
        assert found.attrs["version of numpy"] == np.__version__
        assert len(found.attrs["version of environment.lock"]) == 16
        assert not any(bool(np.isnan(values).any()) for values in found.data_vars.values())
        tasks = list(CAMPAIGN.tasks())
        assert found.peak.values[1, 14:].tolist() == CAMPAIGN.evaluate(tasks[-1])["peak"].tolist()
        assert found.n.values[:7].tolist() == CAMPAIGN.evaluate(tasks[0])["n"].tolist()


def test_benchmarks_have_names(tmp_path):
    campaign = Campaign(BenchmarkPlants(("toy", "ac1")), (Choice("d"),), steps=20)
    store = Store.create(tmp_path / "a", campaign, "", {})
    run(campaign, store, in_process())
    assert store.dataset().name.values.tolist() == ["toy", "ac1"]


@pytest.mark.parametrize("after", [0, 1, 4, 8])
def test_resumed_is_uninterrupted(made, digest, after):
    stopping(made, after)
    again = Store.resume(made.path, CAMPAIGN, SETTINGS)
    assert len(again.done()) == after
    assert again.digest() != digest
    run(CAMPAIGN, again, in_process())
    assert again.digest() == digest


def test_other_seeds_have_another_hash(tmp_path, digest):
    other = replace(CAMPAIGN, plants=replace(CAMPAIGN.plants, seed=2))
    store = Store.create(tmp_path / "a", other, "", {})
    run(other, store, in_process())
    assert store.digest() != digest


@pytest.mark.parametrize("harm", ["a marker without data", "data of another task", "data cut off", "half a marker"])
def test_what_did_not_arrive_whole_is_done_again(made, digest, harm):
    run(CAMPAIGN, made, in_process())
    chunk = made.path / "results.zarr" / "peak" / "0.1"
    if harm == "a marker without data":
        chunk.unlink()
    elif harm == "data of another task":
        chunk.write_bytes((made.path / "results.zarr" / "peak" / "0.0").read_bytes())
    elif harm == "data cut off":
        chunk.write_bytes(chunk.read_bytes()[:20])
    else:
        marker = made.path / "done" / "0-7"
        marker.write_text(marker.read_text(encoding="ascii")[:10], encoding="ascii")
    again = Store.resume(made.path, CAMPAIGN, SETTINGS)
    tasks = set(CAMPAIGN.tasks())
    assert [(task.scheme, task.first) for task in tasks - again.done()] == [(0, 7)]
    run(CAMPAIGN, again, in_process())
    assert again.digest() == digest


def full(*_, **__):
    raise OSError(errno.ENOSPC, "No space left on device")


@pytest.mark.parametrize("where", ["data", "marker"])
def test_a_full_disk(made, digest, monkeypatch, where):
    """Simulated: writing fails from the fourth task on."""
    count, write, array = 0, stores.write_whole, type(made._arrays["peak"])
    put = array.__setitem__

    def marker(path, content):
        nonlocal count
        count += 1
        if count > 3:
            try:
                full()
            except OSError as error:
                raise InputError(f"{path} must be a writable file") from error
        write(path, content)

    def data(self, *arguments):
        nonlocal count
        count += self.basename == "peak"
        full() if count > 3 and self.basename == "peak" else put(self, *arguments)

    with monkeypatch.context() as patched:
        if where == "data":
            patched.setattr(array, "__setitem__", data)
        else:
            patched.setattr(stores, "write_whole", marker)
        with pytest.raises(StoreError, match=r"a must take the results, got: No space left on device; make room$"):
            run(CAMPAIGN, made, in_process())
    again = Store.resume(made.path, CAMPAIGN, SETTINGS)
    assert 3 <= len(again.done()) < len(list(CAMPAIGN.tasks()))
    run(CAMPAIGN, again, in_process())
    assert again.digest() == digest


def test_no_room_for_a_new_store(tmp_path, monkeypatch):
    monkeypatch.setattr(xr.Dataset, "to_zarr", full)
    with pytest.raises(StoreError, match="No space left on device; make room"):
        Store.create(tmp_path / "a", CAMPAIGN, "", {})
    assert list(tmp_path.iterdir()) == []


def test_folders_that_are_refused(made, tmp_path):
    with pytest.raises(InputError, match=r"--output must name a new folder, got .*, which exists; add --resume"):
        Store.create(made.path, CAMPAIGN, "", {})
    with pytest.raises(InputError, match=r"--output must name a folder that can be created, got .*: No such file"):
        Store.create(tmp_path / "no" / "such", CAMPAIGN, "", {})
    with pytest.raises(InputError, match=r"--resume must find a campaign in .* No such file .*; leave it out to start"):
        Store.resume(tmp_path / "b", CAMPAIGN, SETTINGS)
    with pytest.raises(InputError, match=r"--resume must find a campaign in .*; remove the folder and start again"):
        Store.resume(tmp_path, CAMPAIGN, SETTINGS)
    (tmp_path / "provenance.json").write_text("{", encoding="utf-8")
    with pytest.raises(InputError, match=r"got provenance\.json: invalid JSON"):
        Store.resume(tmp_path, CAMPAIGN, SETTINGS)


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        (SETTINGS | {"seed": 2}, "the configuration as at the campaign.s start, got seed = 2, which was 1"),
        (SETTINGS | {"noise": 0.1}, "got noise = 0.1, which was None"),
        ({"schemes": SETTINGS["schemes"]}, "got seed = None, which was 1"),
        (
            SETTINGS | {"schemes": [{"base": "default"}, {"base": "default"}]},
            r"got schemes\[2\].base = 'default', which was",
        ),
        (SETTINGS | {"schemes": [{"base": "default"}]}, "got schemes = "),
    ],
)
def test_another_configuration(made, settings, says):
    with pytest.raises(InputError, match=says):
        Store.resume(made.path, CAMPAIGN, settings)


@pytest.mark.parametrize("name", ["rhl", "python", "numpy", "scipy", "numba", "source of rhl", "environment.lock"])
def test_another_version(made, name):
    path = made.path / "provenance.json"
    provenance = json.loads(path.read_text(encoding="utf-8"))
    provenance["versions"][name] = "0"
    path.write_text(json.dumps(provenance), encoding="utf-8")
    with pytest.raises(InputError, match=f"the versions as at the campaign.s start, got {name} = .*, which was '0'"):
        Store.resume(made.path, CAMPAIGN, SETTINGS)


def test_one_campaign_at_a_time(made):
    pytest.importorskip("fcntl")
    with made.held(), pytest.raises(InputError, match="no other campaign writes into"), made.held():
        pass
    with made.held():
        pass


def test_what_is_not_done_is_seen(made):
    stopping(made, 4)
    found = load(made.path)
    assert np.isnan(found.peak.values).any()
    assert not np.isnan(found.peak.values[0, :7]).any()
