"""Files around the code: workflow, forms, hooks, changelog, citation, rules for tests and for kernels."""

import ast
import os
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
import yaml

ROOT = Path(__file__).parents[1]
PACKAGES = ("spectra", "phantomgen", "recon")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
FORMS = sorted(path for path in (ROOT / ".github/ISSUE_TEMPLATE").glob("*.yml") if path.name != "config.yml")
KERNELS = r"\b(njit|inlined|called|reordered|intrinsic|triton\.jit)\b"


def read(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def functions(*folders: str) -> list[tuple[str, ast.FunctionDef]]:
    """Functions and methods of Python files, with where they stand."""
    found = []
    for path in (path for folder in folders for path in sorted((ROOT / folder).rglob("*.py"))):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        found += [(f"{path.relative_to(ROOT)}:{f.lineno}", f) for f in ast.walk(tree) if isinstance(f, ast.FunctionDef)]
    return found


def test_the_workflow_runs_what_the_makefile_has_on_every_version_of_python():
    workflow = yaml.safe_load(read(".github/workflows/check.yml"))
    steps = [step.get("run", "") for job in workflow["jobs"].values() for step in job["steps"]]
    targets = re.findall(r"^([a-z-]+):", read("Makefile"), re.MULTILINE)
    asked = {target for step in steps for target in re.findall(r"^make (\w+)", step)}
    assert asked == {"check", "test", "docs"}
    assert asked <= set(targets)
    tested = workflow["jobs"]["test"]["strategy"]["matrix"]["include"]
    classified = re.findall(r"Python :: (3\.\d+)", "\n".join(PROJECT["project"]["classifiers"]))
    assert {job["python"] for job in tested} >= {*classified, "3.11", "3.12", "3.13", "3.14"}
    assert {job["system"] for job in tested if "tests" not in job} == {
        "ubuntu-latest",
        "macos-latest",
        "windows-latest",
    }
    parts = {folder for job in tested for folder in job.get("tests", "").split()}
    assert [part for part in parts if not (ROOT / part).exists()] == []


@pytest.mark.parametrize("form", FORMS, ids=lambda path: path.stem)
def test_forms_of_issues_are_complete(form):
    content = yaml.safe_load(form.read_text(encoding="utf-8"))
    assert {"name", "description", "body"} <= set(content)
    names = [entry["id"] for entry in content["body"]]
    assert len(set(names)) == len(names)
    assert any(entry.get("validations", {}).get("required") for entry in content["body"])


def test_hooks_format_by_the_version_of_ruff_that_checks():
    hooks = {
        repo["repo"].rpartition("/")[2]: repo["rev"]
        for repo in yaml.safe_load(read(".pre-commit-config.yaml"))["repos"]
    }
    assert f"ruff=={hooks['ruff-pre-commit'].removeprefix('v')}" in read("constraints.txt").splitlines()


def test_the_changelog_has_the_headings_of_keep_a_changelog():
    lines = read("CHANGELOG.md").splitlines()
    versions = [line for line in lines if line.startswith("## ")]
    assert versions[0] == "## [Unreleased]"
    assert [line for line in versions[1:] if not re.fullmatch(r"## \[\d+\.\d+\.\d+\] - \d{4}-\d\d-\d\d", line)] == []
    kinds = {line for line in lines if line.startswith("### ")}
    assert kinds <= {f"### {kind}" for kind in ("Added", "Changed", "Deprecated", "Removed", "Fixed", "Security")}


def test_the_guide_to_contributions_is_short():
    assert len(read("CONTRIBUTING.md").splitlines()) < 100


def test_the_citation_has_what_its_format_asks_for():
    citation = yaml.safe_load(read("CITATION.cff"))
    assert {"cff-version", "message", "title", "authors"} <= set(citation)
    assert citation["license"] == PROJECT["project"]["license"]


def test_every_test_can_fail():
    checks, found = re.compile(r"\bassert|raises|warns|(grad|op)check"), functions("tests")
    sure = {f.name for _, f in found if checks.search(ast.unparse(f.body))}
    tests = [(place, f) for place, f in found if f.name.startswith("test_") and f.name not in sure]
    called = {place: {ast.unparse(c.func) for c in ast.walk(f) if isinstance(c, ast.Call)} for place, f in tests}
    assert [place for place, names in called.items() if not names & sure] == []


@pytest.mark.skipif("CHECKED_TYPES" in os.environ, reason="checks of types are chosen")
def test_types_and_axes_of_calls_are_checked_in_all_packages():
    from phantomgen.geometry.voxel_grid import Grid
    from recon.gaussians.unseen_rays import certainly_larger
    from spectra.basis.basis import klein_nishina

    for function in (klein_nishina, Grid.__init__, certainly_larger):
        function.calls = 0  # of many calls, only some are checked
    with pytest.raises(TypeError, match="energy"):
        klein_nishina([70.0])  # a list for an array
    with pytest.raises(TypeError, match="spacing"):
        Grid((1, 1, 1), (1.0, 1.0), (0.0, 0.0, 0.0))  # a field of a dataclass
    with pytest.raises(TypeError, match="view"):
        certainly_larger(np.ones(3), np.ones(4))  # an axis of two lengths
    assert certainly_larger(np.array([3.0, 4.0]), np.ones(2)) is True


def test_only_kernels_go_without_checks_of_types():
    free = [(place, [ast.unparse(d) for d in f.decorator_list]) for place, f in functions(*PACKAGES)]
    assert [place for place, d in free if "no_type_check" in d and not re.search(KERNELS, " ".join(d))] == []
