"""Every path, function and class that the page 'Where is what?' names exists, and its folders lead to these files."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/development/where_is_what.md").read_text(encoding="utf-8")
ROWS = [line.strip("| ").split(" | ") for line in PAGE.splitlines() if line.startswith("| ")][1:]
PLACES = [place for row in ROWS for place in re.findall(r"`([^`]+\.py)`: ((?:`[^`]+`(?:, )?)+)", row[2])]


def definitions(node: ast.Module | ast.ClassDef, before: str = "") -> Iterator[str]:
    """Names of functions, classes, their members, and values."""
    for part in node.body:
        if isinstance(part, ast.FunctionDef):
            yield before + part.name
        elif isinstance(part, ast.ClassDef):
            yield before + part.name
            yield from definitions(part, f"{before}{part.name}.")
        elif isinstance(part, ast.Assign | ast.AnnAssign):
            targets = part.targets if isinstance(part, ast.Assign) else [part.target]
            yield from (before + target.id for target in targets if isinstance(target, ast.Name))


@pytest.mark.parametrize(("path", "names"), PLACES, ids=[path for path, _ in PLACES])
def test_files_have_the_functions_that_the_page_names(path, names):
    known = set(definitions(ast.parse((ROOT / path).read_text(encoding="utf-8"))))
    assert set(re.findall(r"`([^`]+)`", names)) <= known


@pytest.mark.parametrize("row", ROWS, ids=[row[0] for row in ROWS])
def test_folders_lead_to_the_files(row):
    """Every package, folder and module of a walk is a part of a path that is named beside it."""
    parts = {part for path in re.findall(r"`([^`]+)\.py`", row[2]) for part in path.split("/")}
    assert len(row) == 3
    assert re.findall(r"`([^`]+)\.py`", row[2])
    assert set(re.findall(r"`([^` ]+)`", row[1])) <= parts
