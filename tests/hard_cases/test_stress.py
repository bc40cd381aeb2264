"""``phantomgen stress``: cases pass, and results that are wrong are noticed."""

import json

import pytest
from click.testing import CliRunner
from support.tiny_scans import one_sentence

from phantomgen.cli.main import main as phantomgen
from phantomgen.stress import rays
from phantomgen.stress.case import Case, Point
from phantomgen.stress.cases import CASES
from phantomgen.stress.report import FILES

NAMED = {case.name: case for case in CASES}


@pytest.mark.parametrize("name", NAMED)
def test_a_case_passes(name):
    outcome = NAMED[name].run()
    assert len(outcome.points) >= 4
    assert outcome.passed, outcome.to_dict()


@pytest.mark.parametrize("error", [2.0, float("nan"), float("inf")])
def test_wrong_results_are_noticed(error):
    case = Case("x", "what", "difficulty", "error", 1.0, lambda: iter((Point(1, 0, 0, 0.5), Point(2, 0, 0, error))))
    assert not case.run().passed


def test_a_shell_that_is_lost_is_noticed(monkeypatch):
    monkeypatch.setattr(rays, "trace", lambda origins, directions, solids, count: directions[:, :count] * 0)
    assert not NAMED["shells"].run().passed
    assert not NAMED["grazing"].run().passed


def test_the_report_of_two_cases(tmp_path):
    words = ["stress", "--case", "shells", "--case", "voxel", "-q", "-o", str(tmp_path / "report")]
    result = CliRunner().invoke(phantomgen, words)
    assert result.exit_code == 0, result.output
    assert sorted(path.name for path in (tmp_path / "report").iterdir()) == sorted(FILES)
    assert [record["name"] for record in json.loads((tmp_path / "report" / FILES[1]).read_text())] == [
        "shells",
        "voxel",
    ]
    assert result.output == (tmp_path / "report" / FILES[0]).read_text()
    assert "exists: choose another name" in one_sentence(CliRunner().invoke(phantomgen, words))


def test_cases_are_listed_and_unknown_ones_refused():
    assert len(CliRunner().invoke(phantomgen, ["stress", "--list"]).output.splitlines()) == len(CASES)
    assert "choose from grazing" in one_sentence(CliRunner().invoke(phantomgen, ["stress", "--case", "x"]))
