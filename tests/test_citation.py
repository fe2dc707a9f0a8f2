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
