"""CITATION.cff is valid, and agrees with the rest of the project."""

import copy
import json
import re
import tomllib
from pathlib import Path

import jsonschema
import pytest
import yaml

ROOT = Path(__file__).resolve().parent.parent
SCHEMA = json.loads((ROOT / "tests/data/cff-1.2.0.schema.json").read_text(encoding="utf-8"))


@pytest.fixture
def citation():
    """The citation file as data; dates stay text, as the schema wants them."""
    return yaml.load((ROOT / "CITATION.cff").read_text(encoding="utf-8"), Loader=yaml.BaseLoader)


def faults(citation):
    """What the schema of CFF 1.2.0 has against `citation`."""
    typed = copy.deepcopy(citation)
    if "year" in typed.get("preferred-citation", {}):
        typed["preferred-citation"]["year"] = int(typed["preferred-citation"]["year"])
    validator = jsonschema.Draft7Validator(SCHEMA)
    return [error.message for error in validator.iter_errors(typed)]


def test_valid(citation):
    assert faults(citation) == []


def test_faults_are_found(citation):
    del citation["authors"]
    citation["preferred-citation"]["doi"] = "2010.05891"
    citation["colour"] = "blue"
    found = " ".join(faults(citation))
    assert "'authors' is a required property" in found
    assert "'2010.05891' does not match" in found
    assert "'colour' was unexpected" in found


def test_agrees_with_the_package(citation):
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert citation["version"] == project["version"]
    assert citation["license"] == project["license"]
    assert [author["name"] for author in citation["authors"]] == [author["name"] for author in project["authors"]]


def test_prefers_the_paper(citation):
    paper = citation["preferred-citation"]
    bibliography = (ROOT / "book/references.bib").read_text(encoding="utf-8")
    entry = dict(re.findall(r"(\w+)\s*=\s*\{(.*)\},", bibliography.partition("{ebenbauer2020,")[2]))
    assert paper["title"] == entry["title"]
    assert paper["doi"] == entry["doi"]
    assert paper["year"] == entry["year"]
    names = " and ".join(f"{author['family-names']}, {author['given-names']}" for author in paper["authors"])
    assert names == entry["author"]


# ---------------------------------------------------------------- the same for other readers


def disagreements(citation, project, codemeta, zenodo):
    """Where codemeta.json and .zenodo.json say something else than CITATION.cff and pyproject.toml."""
    names = [author["name"] for author in citation["authors"]]
    paper = citation["preferred-citation"]
    pairs = {
        "codemeta name": (codemeta["name"], project["name"]),
        "codemeta description": (codemeta["description"], project["description"]),
        "codemeta version": (codemeta["version"], project["version"]),
        "codemeta license": (codemeta["license"], f"https://spdx.org/licenses/{project['license']}"),
        "codemeta authors": ([author["name"] for author in codemeta["author"]], names),
        "codemeta keywords": (codemeta["keywords"], project["keywords"]),
        "codemeta Python": (codemeta["runtimePlatform"], f"Python {project['requires-python']}"),
        "codemeta paper": (
            [codemeta["referencePublication"][key] for key in ("name", "@id")],
            [paper["title"], f"https://doi.org/{paper['doi']}"],
        ),
        "zenodo title": (zenodo["title"], citation["title"]),
        "zenodo description": (zenodo["description"], project["description"]),
        "zenodo version": (zenodo["version"], project["version"]),
        "zenodo license": (zenodo["license"], citation["license"]),
        "zenodo creators": ([creator["name"] for creator in zenodo["creators"]], names),
        "zenodo keywords": (zenodo["keywords"], citation["keywords"]),
        "zenodo paper": ([related["identifier"] for related in zenodo["related_identifiers"]], [paper["doi"]]),
    }
    return [f"{what}: {found!r}, not {wanted!r}" for what, (found, wanted) in pairs.items() if found != wanted]


@pytest.fixture
def records():
    """What the four files say."""
    codemeta, zenodo = (json.loads((ROOT / name).read_text(encoding="utf-8")) for name in (CODEMETA, ZENODO))
    return tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"], codemeta, zenodo


CODEMETA, ZENODO = "codemeta.json", ".zenodo.json"


def test_records_agree(citation, records):
    assert disagreements(citation, *records) == []


def test_disagreements_are_found(citation, records):
    project, codemeta, zenodo = records
    codemeta["version"], zenodo["creators"] = "9", []
    assert disagreements(citation, project, codemeta, zenodo) == [
        f"codemeta version: '9', not {project['version']!r}",
        f"zenodo creators: [], not {[author['name'] for author in citation['authors']]!r}",
    ]
