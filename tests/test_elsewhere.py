"""Numbers of other environments are compared with the reference's, and a wrong or distant one is a failure."""

import json
import subprocess
import sys

import pytest

from tools import elsewhere
from tools.elsewhere import REFERENCE, VARIANTS, NotHereError, Variant


def number(value, tolerance=1e-9, right=True):
    return {"value": value, "tolerance": tolerance, "right": right}


HERE = {"versions": ["3.11"], "kernels": ["Haswell, 2"], "numbers": {"a": number(1e-12), "b": number(2e-12)}}


def there(**numbers):
    return HERE | {"numbers": HERE["numbers"] | numbers}


def test_differences_are_relative_to_the_tolerance():
    reference = {"a": number(1e-12), "refuted": number(5.0), "exact": number(0.0, 0.0), "none": number(None, None)}
    found = {"a": number(2e-12), "refuted": number(9.0), "exact": number(0.0, 0.0), "none": number(None, None)}
    assert elsewhere.differences(found, reference) == {"a": pytest.approx(1e-3)}


def test_what_is_wrong_or_missing_is_found():
    assert elsewhere.faults(HERE["numbers"], HERE["numbers"]) == []
    found = {"b": number(1e-3, right=False)}
    assert elsewhere.faults(found, HERE["numbers"]) == ["a is missing", "b is not as recorded"]


@pytest.mark.parametrize(
    ("found", "fine"),
    [
        (there(), True),
        (there(a=number(5e-10)), True),
        (there(a=number(-2e-9)), False),  # within the tolerance, but far from the reference
        (there(a=number(2e-12, right=False)), False),
        (there() | {"tests": "3 passed in 1 s"}, True),
        (there() | {"tests": "1 failed, 2 passed in 1 s !"}, False),
    ],
)
def test_a_row_says_whether_all_is_as_it_must_be(found, fine):
    row, right = elsewhere.report("somewhere", found, HERE)
    assert right == fine
    assert row.startswith("somewhere")


def test_settings_are_those_of_the_variant_alone(monkeypatch, tmp_path):
    monkeypatch.setenv("OPENBLAS_CORETYPE", "Nehalem")
    monkeypatch.setenv("OPENBLAS_L2_SIZE", "512")
    own = elsewhere.settings(Variant("x", threads=1), tmp_path)
    assert {name: value for name, value in own.items() if "OPENBLAS" in name} == {"OPENBLAS_NUM_THREADS": "1"}
    assert elsewhere.settings(Variant("x", kernel="Haswell"), tmp_path)["OPENBLAS_CORETYPE"] == "Haswell"
    assert "NUMBA_CACHE_DIR" in elsewhere.settings(Variant("x", python="3.12"), tmp_path)


def test_a_kernel_that_the_processor_cannot_run_is_not_tried(monkeypatch, tmp_path):
    monkeypatch.setattr(elsewhere, "flags", lambda: {"sse2"})
    with pytest.raises(NotHereError, match=r"^the processor must have avx2 for the kernel Haswell, but has not$"):
        elsewhere.prepared(Variant("x", kernel="Haswell", flag="avx2"), tmp_path)


def test_settings_reach_the_library_of_linear_algebra(tmp_path):
    asked = Variant("x", threads=1)
    code = "import json; from rhl.paper.environment import libraries; print(json.dumps(libraries()))"
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        env=elsewhere.settings(asked, tmp_path),
    )
    assert {library["threads"] for library in json.loads(done.stdout)} == {1}


@pytest.mark.parametrize(("ci", "status"), [("", 0), ("true", 1)])
def test_a_variant_that_cannot_run_says_why(monkeypatch, capsys, tmp_path, ci, status):
    def run(variant, tests):
        if variant == REFERENCE:
            return HERE
        raise NotHereError("there is no such Python")

    monkeypatch.setattr(elsewhere, "FOLDER", tmp_path)
    monkeypatch.setattr(elsewhere, "run", run)
    monkeypatch.setenv("CI", ci)
    assert elsewhere.main(["python-3.12"], tests=False) == status
    assert "python-3.12   not run: there is no such Python" in capsys.readouterr().out


def test_a_variant_that_does_not_exist_is_refused(capsys):
    assert elsewhere.main(["python-2"], tests=False) == 2
    assert capsys.readouterr().err.startswith("VARIANT must be one of one-thread, ")


def test_names_of_variants_differ():
    names = [variant.name for variant in (REFERENCE, *VARIANTS)]
    assert len(set(names)) == len(names)


def test_the_tests_of_numbers_are_those_of_modules():
    chosen = {path.name for path in (elsewhere.ROOT / "tests").glob("test_*.py") if elsewhere.numeric(path)}
    assert {"test_horizon.py", "test_losses.py", "test_riccati.py"} <= chosen
    assert not {"test_book.py", "test_environment.py", "test_browser.py"} & chosen
