"""The environment that a page names is the one in which it is executed."""

from importlib.metadata import PackageNotFoundError, version

import pytest
import threadpoolctl

from rhl.errors import InputError
from rhl.paper import environment

METADATA = [
    "numpy>=2.0",
    "rich>=13; extra == 'app'",
    "dask[distributed]>=2024.8,<2027; extra == 'study'",
    "rhl[paper]; extra == 'book'",
    "numpy>=2.0; extra == 'study'",
    "never-heard-of>=1; extra == 'study'",
]


def test_packages_are_those_of_the_metadata(monkeypatch):
    monkeypatch.setattr(environment, "requires", lambda name: METADATA)
    assert environment.packages(("", "study")) == [
        {"package": "numpy", "version": version("numpy"), "supported": ">=2.0", "for": ""},
        {"package": "dask", "version": version("dask"), "supported": ">=2024.8, <2027", "for": "study"},
        {"package": "never-heard-of", "version": "not installed", "supported": ">=1", "for": "study"},
    ]


def test_another_version_is_another_row(monkeypatch):
    monkeypatch.setattr(environment, "version", lambda name: "0.0")
    assert {package["version"] for package in environment.packages()} == {"0.0"}


def test_files_alone_are_refused(monkeypatch):
    def missing(name):
        raise PackageNotFoundError(name)

    monkeypatch.setattr(environment, "requires", missing)
    with pytest.raises(InputError, match=r"^rhl must be installed to know its dependencies, got its files alone; run"):
        environment.packages()


def test_nothing_names_the_machine():
    assert "/" not in "".join(map(str, [environment.python(), *environment.libraries()]))


def test_the_number_of_threads_is_that_in_use():
    with threadpoolctl.threadpool_limits(1):
        assert {library["threads"] for library in environment.libraries()} == {1}
