"""The record of the proofs is of the files as they are; Coq accepts these, and rejects false ones where it must."""

import re
import shutil
from dataclasses import replace

import pytest

from rhl.paper import formal
from rhl.paper.claims import ledger
from rhl.paper.claims.claim import Judgement
from rhl.paper.listing import cards
from tests.conftest import ROOT
from tools import proofs

PAGE = ROOT / "book/checked-by-machine.md"
with_coq = pytest.mark.skipif(
    shutil.which("coqc") is None, reason="no Coq; `apt-get install coq libcoq-mathcomp-algebra` brings it"
)


def test_record_is_of_the_sources_as_they_are():
    kept = formal.record()
    assert kept.sources == proofs.hashes(), "type `make proofs`"
    asked = [
        f"{file.stem}.{name}" for file in sorted(proofs.PROOFS.glob("*.v")) for name in proofs.asked(file.read_text())
    ]
    assert list(kept.theorems) == asked
    assert len(asked) >= 10
    assert [of["what"] for of in kept.rejected] == [of.what for of in proofs.FALSE]


def test_a_changed_source_is_noticed(tmp_path, monkeypatch):
    for file in proofs.PROOFS.glob("*.v"):
        shutil.copy(file, tmp_path)
    monkeypatch.setattr(proofs, "PROOFS", tmp_path)
    assert proofs.hashes() == formal.record().sources
    with (tmp_path / "lemma_5.v").open("a") as file:
        file.write("\n")
    assert proofs.hashes() != formal.record().sources


def test_nothing_on_record_rests_on_an_axiom():
    assert set(formal.record().theorems.values()) == {proofs.CLOSED}


@pytest.mark.parametrize("file", sorted(proofs.PROOFS.glob("*.v")), ids=lambda file: file.name)
def test_every_theorem_is_asked_what_it_rests_on(file):
    text = file.read_text(encoding="utf-8")
    stated = re.findall(r"^Theorem (\w+)", text, flags=re.MULTILINE)
    assert set(stated) - set(proofs.asked(text)) <= {"quadratic_distance"}  # a step of the theorem after it
    assert not re.search(r"\b(Admitted|Axiom|Parameter|Conjecture|admit)\b", text)


def test_the_ledger_names_theorems_that_are_on_record_and_on_the_page():
    named = [claim.formal for claim in ledger.CLAIMS if claim.formal]
    assert len(named) >= 4
    assert set(named) <= set(formal.record().theorems)
    page = PAGE.read_text(encoding="utf-8")
    assert [name for name in formal.record().theorems if f"({formal.anchor(name)})=" not in page] == []


def test_the_ledger_links_to_the_theorem():
    (claim,) = ledger.select(["lemma-5.count"])
    judged = Judgement(claim, "holds", None, None, None, "", 0.0)
    assert judged.status == "machine-checked"
    row = cards([judged])
    assert 'href="checked-by-machine.html#lemma-5-enough-nonzero-weights"' in row
    assert "checked-by-machine" not in cards([replace(judged, claim=replace(claim, formal=""))])


def test_false_theorems_change_what_stands_in_the_files():
    for false in proofs.FALSE:
        assert proofs.altered(false) != (proofs.PROOFS / false.file).read_text(encoding="utf-8")
    with pytest.raises(ValueError, match="must contain exactly once the part to change"):
        proofs.altered(replace(proofs.FALSE[0], old="no such words"))


def test_answers_are_told_apart():
    said = f"{proofs.CLOSED}\nAxioms:\nf : nat\ng : nat\n{proofs.CLOSED}\n"
    assert proofs.axioms(said, ["a", "b", "c"]) == {
        "a": proofs.CLOSED,
        "b": "Axioms:\nf : nat\ng : nat",
        "c": proofs.CLOSED,
    }
    with pytest.raises(ValueError, match="must answer for 2 theorems, got 3"):
        proofs.axioms(said, ["a", "b"])


def test_missing_coq_is_one_sentence(monkeypatch, capsys):
    monkeypatch.setattr(proofs.shutil, "which", lambda name: None)
    assert proofs.main() == 1
    said = capsys.readouterr()
    assert (said.out, said.err) == ("", f"{proofs.MISSING}\n")
    assert "apt-get install" in proofs.MISSING


def test_what_goes_wrong_is_said_and_nothing_is_kept(monkeypatch, capsys, tmp_path):
    def accepted():
        raise ValueError("Coq must reject it")

    monkeypatch.setattr(proofs, "record", accepted)
    monkeypatch.setattr(proofs, "RECORD", tmp_path / "proofs.json")
    assert proofs.main() == 1
    assert capsys.readouterr().err == "Coq must reject it\n"
    assert not proofs.RECORD.exists()


@pytest.mark.nightly  # `make proofs` is the same, and a step of continuous integration
@with_coq
def test_coq_accepts_and_rejects_what_is_on_record():
    found, kept = proofs.record(), formal.record()
    assert found["theorems"] == kept.theorems
    if proofs.version() == kept.coq:  # where an error stands may change with the version
        assert found["rejected"] == list(kept.rejected)


@with_coq
def test_a_gap_in_a_proof_is_an_axiom(tmp_path):
    source = tmp_path / "gap.v"
    source.write_text("Theorem gap : 0 = 1.\nProof.\nAdmitted.\nPrint Assumptions gap.\n")
    assert proofs.check(source) == {"gap": "Axioms:\ngap : 0 = 1"}


@with_coq
def test_a_wrong_proof_ends_the_run(tmp_path):
    source = tmp_path / "wrong.v"
    source.write_text("Theorem wrong : 0 = 1.\nProof. reflexivity. Qed.\n")
    with pytest.raises(SystemExit, match=r"Coq rejects wrong\.v"):
        proofs.check(source)


@with_coq
@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"old": "Print Assumptions three_point.", "new": ""}, "must reject equation_44.v .* and accepts it"),
        ({"at": "Proof. ring. Qed."}, "must stop at 'Proof. ring. Qed.'"),
        ({"says": "No applicable tactic"}, "with 'No applicable tactic', got line"),
    ],
)
def test_a_false_theorem_that_fails_otherwise_than_intended_is_noticed(change, sentence):
    (false,) = (of for of in proofs.FALSE if of.file == "equation_44.v")
    with pytest.raises(ValueError, match=sentence):
        proofs.rejection(replace(false, **change))
