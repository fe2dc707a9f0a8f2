"""The workflows, tried without their host: pinned actions, least permissions, targets that exist, shell that parses."""

import re
import subprocess
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).resolve().parent.parent
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
# What a job may be allowed, and by which action of its steps it is needed.
NEEDED = {
    "contents: read": "actions/checkout",
    "pages: write": "actions/deploy-pages",
    "id-token: write": "actions/deploy-pages",
}
PINNED = re.compile(r"[\w-]+/[\w.-]+@[0-9a-f]{40} # v\d+\.\d+\.\d+")


def steps(workflow):
    """Each step, with the values of its job's matrix by their names."""
    for job in workflow["jobs"].values():
        matrix = job.get("strategy", {}).get("matrix", {})
        for step in job["steps"]:
            yield step, matrix


def scripts(workflow):
    """The shell of each step, once for each value of the matrix that it uses."""
    for step, matrix in steps(workflow):
        if "run" in step:
            name = re.search(r"\$\{\{ matrix\.(\w+) \}\}", step["run"])
            values = matrix[name[1]] if name else [""]
            yield from (step["run"].replace(name[0], value) if name else step["run"] for value in values)


def targets(makefile):
    return set(re.findall(r"^([a-z-]+):", makefile, re.MULTILINE))


def faults(text, makefile):
    """What is wrong with a workflow, given as text, in one line each."""
    workflow, found = yaml.safe_load(text), []
    # With the comment that tells a reader the version of the commit.
    used = re.findall(r"^\s*(?:- )?uses: *(.+?)\s*$", text, re.MULTILINE)
    found += [f"{one} is not pinned" for one in used if not PINNED.fullmatch(one)]
    if workflow.get("permissions") != {}:
        found.append("the workflow gives permissions to every job")
    for name, job in workflow["jobs"].items():
        if "timeout-minutes" not in job:
            found.append(f"{name} has no time limit")
        given = {f"{what}: {how}" for what, how in (job.get("permissions") or {"nothing": "said"}).items()}
        actions = {step.get("uses", "").partition("@")[0] for step in job["steps"]}
        wanted = {permission for permission, action in NEEDED.items() if action in actions}
        if given != wanted:
            found.append(f"{name} has the permissions {sorted(given)}, and needs {sorted(wanted)}")
    for step, _ in steps(workflow):
        kept = (step.get("with") or {}).get("persist-credentials", True)
        if "actions/checkout" in step.get("uses", "") and kept is not False:
            found.append("a checkout keeps its token")
    for script in scripts(workflow):
        # At the start of a command; apt-get installs a package of that name too.
        asked = set(re.findall(r"(?:^|&&|;)\s*make ([\w-]+)", script, re.MULTILINE))
        found += [f"make {target} is no target" for target in sorted(asked - targets(makefile))]
        # Expressions of the host stand for a word.
        plain = re.sub(r"\$\{\{.*?\}\}", "word", script)
        if subprocess.run(["bash", "-n"], input=plain, text=True, capture_output=True, check=False).returncode:
            found.append(f"the shell does not parse: {script}")
        if "github.event" in script or "github.head_ref" in script:
            found.append("what a stranger names becomes part of a script")
    return found


MAKEFILE = (ROOT / "Makefile").read_text(encoding="utf-8")


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.name)
def test_workflows(path):
    assert faults(path.read_text(encoding="utf-8"), MAKEFILE) == []


def test_there_are_two_of_them_and_they_call_what_they_must():
    assert [path.name for path in WORKFLOWS] == ["ci.yml", "nightly.yml"]
    called = {path.name: "\n".join(scripts(yaml.safe_load(path.read_text(encoding="utf-8")))) for path in WORKFLOWS}
    for target in ("book", "test", "proofs"):
        assert f"make {target}" in called["ci.yml"]
    for target in ("test-all", "mutants", "clean-room", "repeatable", "elsewhere", "audit"):
        assert f"make {target}" in called["nightly.yml"]
    for needed in ("chromium", "npm"):
        assert all(needed in script for script in called.values())
        assert needed in (ROOT / ".ci" / "run").read_text(encoding="utf-8")


CI = WORKFLOWS[0].read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("old", "new", "fault"),
    [
        (r"checkout@[0-9a-f]{40}", "checkout@v4", "is not pinned"),
        (r"checkout@[0-9a-f]{40}", "checkout@11bd719", "is not pinned"),
        (r" # v4\.2\.2", "", "is not pinned"),
        (r"permissions: \{\}.*", "permissions: write-all", "gives permissions to every job"),
        (r"contents: read", "contents: write", "test has the permissions ['contents: write'], and needs"),
        (r"    permissions:\n      contents: read\n", "", "test has the permissions ['nothing: said']"),
        (r"    timeout-minutes: 45\n", "", "test has no time limit"),
        (r"persist-credentials: false", "persist-credentials: true", "a checkout keeps its token"),
        (r"make book", "make bok", "make bok is no target"),
        (r"mkdir -p reports", "if mkdir -p reports", "the shell does not parse"),
        (r"mkdir -p reports", r"echo ${{ github.event.pull_request.title }}", "what a stranger names"),
    ],
)
def test_another_workflow_is_refused(old, new, fault):
    changed, count = re.subn(old, new.replace("\\", "\\\\"), CI, count=1)
    assert count == 1
    assert any(fault in one for one in faults(changed, MAKEFILE)), faults(changed, MAKEFILE)


def test_binder_installs_what_the_lock_pins():
    requirements = (ROOT / "binder" / "requirements.txt").read_text(encoding="utf-8")
    assert [line for line in requirements.splitlines() if not line.startswith("#")] == ["-r ../environment.lock"]
    assert (ROOT / "binder" / "runtime.txt").read_text(encoding="utf-8") == "python-3.11\n"
    script = ROOT / "binder" / "postBuild"
    assert subprocess.run(["bash", "-n", script], check=False).returncode == 0
    assert script.stat().st_mode & 0o111
    assert "--no-deps --no-build-isolation --no-index ." in script.read_text(encoding="utf-8")


def test_the_scripts_of_this_folder_parse():
    for script in (ROOT / ".ci" / "run", ROOT / "binder" / "postBuild"):
        assert subprocess.run(["bash", "-n", script], check=False).returncode == 0
    broken = subprocess.run(["bash", "-n"], input="if true; then", text=True, capture_output=True, check=False)
    assert broken.returncode != 0
