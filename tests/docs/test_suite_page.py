"""The script of the page about the suite is a method, and its commands and hashes are those of the program."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from support.tiny_scans import make

from phantomgen.dataset.truth import read_truth
from phantomgen.suite.definition import read_suite

PAGE = (Path(__file__).parents[2] / "docs/howto/suite.md").read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_script_of_the_page_is_a_method(tmp_path):
    (script,) = re.findall(r"^```python\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)
    (tmp_path / "mine.py").write_text(script)
    scan = make(tmp_path / "scan.h5", "--views", "12", "--test-views", "2")
    subprocess.run([sys.executable, "mine.py", scan, "out.npy"], cwd=tmp_path, check=True, timeout=120)
    volumes, truth = np.load(tmp_path / "out.npy"), read_truth(scan).volumes
    assert volumes.shape == truth.shape
    errors = np.linalg.norm((volumes - truth).reshape(3, -1), axis=1) / np.linalg.norm(truth.reshape(3, -1), axis=1)
    assert errors[1] < 0.3
    assert errors.max() < 0.7


def test_the_page_names_all_cases_and_the_hash_to_cite():
    suite = read_suite("v1", "minutes")
    assert re.findall(r"^\| `([a-z-]+)` \|", PAGE, re.MULTILINE)[: len(suite.cases)] == [c.name for c in suite.cases]
    assert f"`{suite.sha256[:12]}`" in PAGE


def test_the_measured_table_is_of_the_suite_as_it_is():
    root = Path(__file__).parents[2]
    page, raw = root / "docs/reference/benchmarks/suite.md", root / "benchmarks/results/suite-v1-minutes.md"
    page, raw = (path.read_text(encoding="utf-8") for path in (page, raw))
    suite = read_suite("v1", "minutes")
    assert f"`{suite.sha256}`" in raw
    assert f"`{suite.sha256[:12]}`" in page
    rows = [line for line in page.splitlines() if line.startswith("|")]
    assert len(rows) == 6
    assert set(rows) <= set(raw.splitlines())
    for case in suite.cases:
        assert f"Counts `{suite.expected[case.name]['arrays']['counts']['sha256'][:12]}`" in raw
