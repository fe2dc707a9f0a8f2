"""A campaign's folder from a stranger, or damaged: refused in one sentence before it is opened, or done again."""

import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from rhl import InputError
from rhl.study import _layout
from rhl.study.backends import in_process
from rhl.study.campaign import PLANT_VARIABLES, RUN_VARIABLES, Campaign, run
from rhl.study.choices import Choice
from rhl.study.ensembles import BenchmarkPlants, RandomPlants
from rhl.study.store import Store, StoreError, load

pytest.importorskip("xarray")
numcodecs = pytest.importorskip("numcodecs")

CAMPAIGN = Campaign(RandomPlants(1, 6, n=(2, 3)), (Choice("d"), Choice("w", "window")), steps=20, chunk=5)
NAMED = Campaign(BenchmarkPlants(("toy", "ac1")), (Choice("d"),), steps=20)
SETTINGS = {"seed": 1}


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """A complete campaign."""
    store = Store.create(tmp_path_factory.mktemp("kept") / "a", CAMPAIGN, "seed = 1", SETTINGS)
    run(CAMPAIGN, store, in_process())
    return store


@pytest.fixture
def folder(kept, tmp_path):
    """A copy of it, to be harmed."""
    shutil.copytree(kept.path, tmp_path / "a")
    return tmp_path / "a"


def resumed(folder):
    """Resume a campaign, and return its hash."""
    store = Store.resume(folder, CAMPAIGN, SETTINGS)
    with store.held():
        run(CAMPAIGN, store, in_process())
    return store.digest()


def refused(folder, found):
    """What loads and what resumes a folder refuses it, and says in one line what was found and what to do."""
    for way in (load, resumed):
        with pytest.raises(InputError) as caught:
            way(folder)
        said = str(caught.value)
        assert f"got {found}" in said
        assert said.endswith(("; copy the folder again, or start the campaign again in another one", "; enlarge chunk"))
        assert said.isprintable()


def chunk(folder, name="peak"):
    return folder / "results.zarr" / name / ("0.0" if name in RUN_VARIABLES else "0")


def rewritten(folder, where, change):
    """Change metadata in both places."""
    data = folder / "results.zarr"
    together = json.loads((data / ".zmetadata").read_text("utf-8"))
    change(together["metadata"][where])
    (data / where).write_text(json.dumps(together["metadata"][where]), encoding="utf-8")
    (data / ".zmetadata").write_text(json.dumps(together), encoding="utf-8")


def test_what_no_one_harmed_is_accepted(kept, folder):
    assert resumed(folder) == kept.digest()
    assert _layout.sizes(folder, whole=True) == _layout.Sizes(schemes=2, plants=12, chunk=5)
    # Files that the store does not read are nobody's business.
    (folder / "notes.txt").write_text("mine", encoding="utf-8")
    (folder / "results.zarr" / "peak" / ".DS_Store").write_text("", encoding="utf-8")
    assert resumed(folder) == kept.digest()


def test_what_a_killed_process_was_writing_is_left_alone(kept, folder):
    """zarr writes a chunk under another name first; a chunk of that content under its own name is refused."""
    for name, at in (("n", "0"), ("peak", "0")):
        (folder / "results.zarr" / name / f"{at}.{16 * '0a'}.partial").touch()
    assert load(folder).equals(kept.dataset())
    assert resumed(folder) == kept.digest()
    chunk(folder, "n").write_bytes(b"")
    with pytest.raises(InputError, match=r"got 'n/0' of 0 bytes"):
        load(folder)


@pytest.mark.parametrize("chunks", [1, 2, 7])
def test_a_campaign_with_names_is_accepted(tmp_path, chunks):
    campaign = Campaign(NAMED.plants, NAMED.schemes, steps=20, chunk=chunks)
    store = Store.create(tmp_path / "a", campaign, "", SETTINGS)
    assert np.isnan(load(store.path).peak.values).all()  # nothing is done yet
    run(campaign, store, in_process())
    assert Store.resume(store.path, campaign, SETTINGS).dataset().name.values.tolist() == ["toy", "ac1"]


@pytest.mark.parametrize(
    ("key", "value", "found"),
    [
        ("shape", [-(10**15)], "peak with shape [-1000000000000000]"),
        ("shape", [400_000_000], "peak with shape [400000000]"),
        ("shape", ["2", "12"], "peak with shape ['2', '12']"),
        ("shape", [2.0, 12], "peak with shape [2.0, 12]"),
        ("shape", [True, 12], "peak with shape [True, 12]"),
        ("shape", "22", "peak with shape '22'"),
        ("shape", [], "peak with shape []"),
        ("shape", [2, 0], "peak with shape [2, 0]"),
        ("shape", [1] * 100, "peak with shape [1, 1"),
        ("shape", [2, 3], "peak with chunks [1, 5] for shape [2, 3]"),
        ("shape", [2, 13], "peak of shape [2, 13], where [2, 12] is expected"),
        ("shape", [2, 10**12], "peak in 400000000000 chunks, of which there are at most 100000"),
        ("chunks", [0, 0], "peak with chunks [0, 0]"),
        ("chunks", [-1, 10**15], "peak with chunks [-1, 1000000000000000]"),
        ("chunks", [1], "peak with chunks [1]"),
        ("chunks", [1, 1], "peak in chunks of [1, 1], where [1, 5] is expected"),
        ("chunks", None, "peak with chunks None"),
        ("order", "X", "peak with order 'X'"),
        ("order", "F", "peak with order 'F'"),
        ("dimension_separator", "/", "peak with dimension_separator '/'"),
        ("dimension_separator", "../..", "peak with dimension_separator '../..'"),
        ("zarr_format", 3, "peak with zarr_format 3"),
        ("zarr_format", 99, "peak with zarr_format 99"),
        ("zarr_format", 2.0, "peak with zarr_format 2.0"),
        ("dtype", "<f3", "peak of type '<f3'"),
        ("dtype", "<f16", "peak of type '<f16'"),
        ("dtype", "<U0", "peak of type '<U0'"),
        ("dtype", "|i1", "peak of type '|i1'"),
        ("dtype", "", "peak of type ''"),
        ("dtype", None, "peak of type None"),
        ("fill_value", "zzz", "peak with fill_value 'zzz'"),
        ("fill_value", {"a": 1}, "peak with fill_value {'a': 1}"),
        ("fill_value", 0, "peak with fill_value 0"),
        ("filters", [{"id": "delta", "dtype": "<f8"}], "peak with filters"),
        ("compressor", None, "peak with compressor None"),
        ("compressor", {"id": "zlib", "level": 1}, "peak with compressor {'id': 'zlib', 'level': 1}"),
        ("compressor", {"id": "blosc", "cname": "x"}, "peak with compressor {'id': 'blosc', 'cname': 'x'}"),
        ("extra", 1, "peak/.zarray that no campaign writes"),
    ],
)
def test_arrays_that_no_campaign_describes(folder, key, value, found):
    rewritten(folder, "peak/.zarray", lambda about: about.update({key: value}))
    refused(folder, found)


@pytest.mark.parametrize(
    ("name", "value", "found"),
    [
        ("scheme", "<U0", "scheme of type '<U0'"),
        ("scheme", "<f8", "scheme of type '<f8'"),
        ("plant", "<M8[s]", "plant of type '<M8[s]'"),
        ("n", "<i8", "n of type '<i8'"),
        ("at_rest", "<f8", "at_rest of type '<f8'"),
        ("at_rest", "|i1", "at_rest without the attribute dtype"),
    ],
)
def test_types_that_no_campaign_has(folder, name, value, found):
    rewritten(folder, f"{name}/.zarray", lambda about: about.update(dtype=value))
    refused(folder, found)


def test_a_wrong_compressor_is_seen_in_every_setting():
    good = {"id": "blosc", "cname": "lz4", "clevel": 5, "shuffle": 1, "blocksize": 0}
    assert _layout._is_blosc(good)
    bad = {"id": "zstd", "cname": "x", "clevel": 10, "shuffle": 3, "blocksize": 1, "typesize": 8}
    for key, value in bad.items():
        assert not _layout._is_blosc(good | {key: value})
    assert not _layout._is_blosc(good | {"clevel": True})
    assert not _layout._is_blosc(good | {"cname": ["lz4"]})


def test_one_array_may_not_hide_another(folder):
    """The sum over all arrays cannot be made small by one of negative size, which is not read."""
    data = folder / "results.zarr"
    (data / "x").mkdir()
    hidden = {"compressor": None, "filters": None, "dtype": "<f8", "shape": [-(10**15)], "chunks": [1]}
    (data / "x" / ".zarray").write_text(json.dumps(hidden), encoding="utf-8")
    refused(folder, "the folder 'x'")
    (data / "x" / ".zarray").unlink()
    (data / "x").rmdir()
    assert load(folder).sizes["plant"] == 12


def test_a_store_of_more_than_a_campaigns_size(folder):
    for name in (*PLANT_VARIABLES, *RUN_VARIABLES, "plant"):
        last = [10**8, 10**6] if name != "plant" else [10**8, 10**8]

        def grow(about, last=last):
            about["shape"][-1], about["chunks"][-1] = last

        rewritten(folder, f"{name}/.zarray", grow)
    for way in (load, resumed):
        with pytest.raises(InputError, match=r"got \d+ bytes, of which there are at most 2000000000; give fewer"):
            way(folder)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        *(("scale_factor", 1.5), ("add_offset", 0.1), ("scale_factor", "x"), ("_FillValue", "zz")),
        *(("dtype", "object"), ("coordinates", "../../x"), ("missing_value", 1), ("_Unsigned", "true")),
    ],
)
def test_attributes_that_no_campaign_writes(folder, key, value):
    rewritten(folder, "peak/.zattrs", lambda about: about.update({key: value}))
    refused(folder, f"peak with the attribute {key!r}")


@pytest.mark.parametrize(
    ("key", "value", "found"),
    [
        ("units", "days since 2000-01-01", "peak with the attribute units 'days since 2000-01-01'"),
        ("units", "days since forever", "peak with the attribute units"),
        ("_ARRAY_DIMENSIONS", ["a"], "peak with the attribute _ARRAY_DIMENSIONS ['a']"),
        ("_ARRAY_DIMENSIONS", ["plant", "scheme"], "peak with the attribute _ARRAY_DIMENSIONS"),
        ("_ARRAY_DIMENSIONS", 5, "peak with the attribute _ARRAY_DIMENSIONS 5"),
    ],
)
def test_attributes_with_other_values(folder, key, value, found):
    rewritten(folder, "peak/.zattrs", lambda about: about.update({key: value}))
    refused(folder, found)
    rewritten(folder, "peak/.zattrs", lambda about: about.pop(key))
    refused(folder, f"peak without the attribute {key}")


@pytest.mark.parametrize("attributes", [{"coordinates": "peak"}, {"steps": 1.5}, {"title": ["a"]}])
def test_attributes_of_the_whole_that_no_campaign_writes(folder, attributes):
    rewritten(folder, ".zattrs", lambda about: about.update(attributes))
    refused(folder, "the attribute ")


def without(name):
    def change(folder):
        path = folder / "results.zarr" / ".zmetadata"
        together = json.loads(path.read_text("utf-8"))
        for part in (".zarray", ".zattrs"):
            del together["metadata"][f"{name}/{part}"]
        path.write_text(json.dumps(together), encoding="utf-8")

    return change


def together(**changes):
    def change(folder):
        path = folder / "results.zarr" / ".zmetadata"
        path.write_text(json.dumps(json.loads(path.read_text("utf-8")) | changes), encoding="utf-8")

    return change


def named(name):
    """Describe an array under another name."""

    def change(folder):
        path = folder / "results.zarr" / ".zmetadata"
        about = json.loads(path.read_text("utf-8"))
        about["metadata"][f"{name}/.zarray"] = about["metadata"]["peak/.zarray"]
        path.write_text(json.dumps(about), encoding="utf-8")

    return change


@pytest.mark.parametrize(
    ("harm", "found"),
    [
        (without("peak"), "no array peak"),
        (without("scheme"), "no array scheme"),
        (without("n"), "no array n"),
        (named("../../b/results.zarr/peak"), "the array '../../b/results.zarr/peak'"),
        (named("/b/peak"), "the array '/b/peak'"),
        (named("name"), "'name/.zattrs' missing from .zmetadata"),
        (together(zarr_consolidated_format=2), ".zmetadata of the format 2"),
        (together(more=1), ".zmetadata that no campaign writes"),
        (together(metadata=[]), ".zmetadata that no campaign writes"),
        (lambda folder: (folder / "results.zarr" / ".zgroup").unlink(), "no .zgroup"),
        (lambda folder: (folder / "results.zarr" / ".zmetadata").unlink(), "no .zmetadata"),
        (lambda folder: (folder / "results.zarr" / "peak" / ".zarray").unlink(), "no peak/.zarray"),
        (lambda folder: shutil.rmtree(folder / "results.zarr" / "peak"), "no peak/.zarray"),
        (lambda folder: shutil.rmtree(folder / "results.zarr"), "no .zmetadata"),
        (lambda folder: rewritten(folder, ".zgroup", lambda about: about.update(zarr_format=3)), ".zgroup {"),
    ],
)
def test_stores_of_other_contents(folder, harm, found):
    harm(folder)
    refused(folder, found)


@pytest.mark.parametrize("where", [".zgroup", ".zattrs", "peak/.zarray", "peak/.zattrs"])
def test_metadata_that_contradict_each_other(folder, where):
    (folder / "results.zarr" / where).write_text('{"a": 1}', encoding="utf-8")
    refused(folder, f"{where} that differs from .zmetadata")
    (folder / "results.zarr" / where).write_text("[" * 100_000, encoding="utf-8")
    refused(folder, f"{where} that no campaign writes")


def bomb(size):
    """A chunk of zeros, packed."""
    return numcodecs.Blosc("zstd", 9).encode(np.zeros(size, dtype="u1"))


@pytest.mark.parametrize("name", ["peak", "scheme"])
def test_a_chunk_that_promises_too_much_is_not_unpacked(kept, folder, name):
    size = 40 if name == "peak" else 8
    content = bomb(100_000_000)
    header = content[:12] + (size + 16).to_bytes(4, "little")
    chunk(folder, name).write_bytes(header + content[16 : size + 16])
    with pytest.raises(InputError, match=rf"got '{name}/0\S*' that unpacks to 100000000 bytes for a chunk of {size}; "):
        load(folder)
    if name == "peak":
        assert resumed(folder) == kept.digest()  # its task is done again
    else:
        refused(folder, "'scheme/0' that unpacks to 100000000 bytes for a chunk of 8")


@pytest.mark.parametrize("name", ["peak", "scheme"])
def test_a_chunk_that_is_too_long_is_not_read(kept, folder, name):
    sparse(chunk(folder, name))
    with pytest.raises(InputError, match=rf"got '{name}/0\S*' of 10000000000 bytes, not the \d\d of its header, for a"):
        load(folder)
    if name == "peak":
        assert resumed(folder) == kept.digest()
    else:
        refused(folder, "'scheme/0' of 10000000000 bytes, not the 24 of its header, for a chunk of 8")


def sparse(path):
    """Make a file of 10 GB that takes no room on the disk."""
    with path.open("r+b") as file:
        file.truncate(10**10)


def test_a_chunk_that_is_longer_packed_than_by_its_header(folder):
    content = chunk(folder).read_bytes()
    content = content[:12] + (len(content) + 1).to_bytes(4, "little") + content[16:] + b"x"
    chunk(folder).write_bytes(content)
    with pytest.raises(
        InputError, match=r"got 'peak/0\.0' of 57 bytes, not the 57 of its header, for a chunk of 40; resu"
    ):
        load(folder)


# What unpacks by its header, but not by its content.
SPOILT = bytes([2, 1, 0x80, 8, *(40, 0, 0, 0), *(40, 0, 0, 0), *(56, 0, 0, 0)]) + b"\xff" * 40


@pytest.mark.parametrize(
    "content",
    [b"", bytes(7), bytes(56), bomb(40)[:-3], bomb(8), SPOILT],
    ids=["empty", "cut in its header", "zeros", "cut", "too little", "spoilt"],
)
@pytest.mark.parametrize("at", ["0.0", "0.2"])  # the last chunk of a row is longer than its task
def test_a_damaged_chunk_is_done_again(kept, folder, content, at):
    chunk(folder).with_name(at).write_bytes(content)
    found = "must hold whole chunks, got peak: " if content == SPOILT else "results.zarr, got 'peak/0"
    with pytest.raises(InputError, match=f"{found}.*; resume the campaign, which computes damaged results again"):
        load(folder)
    assert resumed(folder) == kept.digest()


@pytest.mark.parametrize("number", [0xFFFFFFFF, 0x110000, 0xD800])
def test_names_of_what_is_no_character(folder, number):
    chunk(folder, "scheme").write_bytes(numcodecs.Blosc("lz4").encode(np.array([number, ord("w")], dtype="<u4")))
    with pytest.raises(InputError, match="must hold whole chunks, got scheme: "):
        load(folder)
    chunk(folder, "scheme").write_bytes(numcodecs.Blosc("lz4").encode(np.array([0x1F600, ord("w")], dtype="<u4")))
    assert load(folder).scheme.values.tolist() == ["\U0001f600", "w"]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="a system without pipes in folders")
@pytest.mark.parametrize("where", ["provenance.json", "lock", "done/0-0", "results.zarr/.zmetadata"])
@pytest.mark.parametrize("kind", ["pipe", "folder"])
def test_what_is_no_file(folder, where, kind):
    """Whoever opens a pipe that nobody writes into waits for ever."""
    path = folder / where
    path.unlink(missing_ok=True)
    os.mkfifo(path) if kind == "pipe" else path.mkdir()
    refused(folder, f"{path}, which is not a plain file")


@pytest.mark.parametrize("where", ["done", "results.zarr"])
def test_what_is_no_folder(folder, where):
    shutil.rmtree(folder / where)
    (folder / where).write_text("", encoding="utf-8")
    refused(folder, f"{folder / where}, which is not a plain folder")


def test_markers_that_are_gone_or_too_long(kept, folder):
    sparse(folder / "done" / "0-0")
    assert resumed(folder) == kept.digest()
    assert (folder / "done" / "0-0").stat().st_size == 64
    shutil.rmtree(folder / "done")
    assert resumed(folder) == kept.digest()


@pytest.mark.parametrize("name", ["mkdir", "open"])
def test_a_folder_that_takes_nothing(folder, monkeypatch, name):
    """Neither the folder of the markers nor the lock."""
    original = getattr(Path, name)

    def fail(path, *arguments, **named):
        if path.name in ("done", "lock"):
            raise PermissionError(13, "Permission denied")
        return original(path, *arguments, **named)

    monkeypatch.setattr(Path, name, fail)
    with pytest.raises(StoreError, match=r"a must take the results, got: Permission denied$"):
        resumed(folder)


@pytest.mark.parametrize(
    ("other", "found"),
    [
        (Campaign(CAMPAIGN.plants, (Choice("d"),), steps=20, chunk=5), "2 schemes on 12 plants, 5 in a chunk"),
        (Campaign(RandomPlants(1, 7), CAMPAIGN.schemes, steps=20, chunk=5), "2 schemes on 12 plants, 5 in a chunk"),
        (Campaign(CAMPAIGN.plants, CAMPAIGN.schemes, steps=20, chunk=4), "2 schemes on 12 plants, 5 in a chunk"),
    ],
)
def test_a_store_of_other_sizes_than_the_configuration(folder, other, found):
    with pytest.raises(InputError, match=f"must hold results of .*, as the configuration has, got {found}; start"):
        Store.resume(folder, other, SETTINGS)


def test_a_campaign_that_could_not_be_read_is_not_begun(tmp_path, monkeypatch):
    monkeypatch.setattr(_layout, "_CHUNKS", 5)
    with pytest.raises(InputError, match="in 6 chunks, of which there are at most 5; enlarge chunk"):
        Store.create(tmp_path / "a", CAMPAIGN, "", SETTINGS)
    assert list(tmp_path.iterdir()) == []
    monkeypatch.setattr(_layout, "_CHUNKS", 6)
    Store.create(tmp_path / "a", CAMPAIGN, "", SETTINGS)


@pytest.mark.parametrize("path", ["no", "a\0b"])
def test_no_such_folder(tmp_path, path):
    with pytest.raises(InputError, match=r"must hold a campaign's results\.zarr, got: "):
        load(tmp_path / path)
