"""Results on a suite: merging of submissions, and their table."""

import csv
import json

import pytest

from recon.suite.figure import cases_and_methods
from recon.suite.results import merged, read_results
from recon.suite.table import mean_levels, page, summary_table, write_csv
from spectra.errors import InputError


def row(case: str, method: str, psnr: float | None, submission: int = 0) -> dict:
    """A row with one volume, or with an error."""
    scores = {} if psnr is None else {"compton": psnr}
    found = {
        "case": case,
        "method": method,
        "budget": 30.0,
        "submission": submission,
        "seconds": 12.5,
        "memory_mib": 200.0,
        "psnr": scores,
        "rmse": dict.fromkeys(scores, 0.001),
        "ssim": dict.fromkeys(scores, 0.9),
        "mean_psnr": psnr,
        "views_psnr": None,
    }
    return found | ({"error": "it did not converge"} if psnr is None else {})


def results(label: str, rows: list[dict], **changed: str) -> dict:
    """Results of one submission on two cases."""
    scan = {"what": "an object", "agreement": "identical", "scene": "a" * 64, "arrays": {"counts": "c" * 64}}
    submission = {
        "label": label,
        "program": "spectral-ct 0.1.0",
        "clock": "cpu",
        "threads": 1,
        "environment": {"numpy": "2.0"},
        "scans": {"first": scan, "second": scan},
    }
    head = {"schema": "spectral-ct-suite-score", "suite": "v1", "tier": "minutes", "sha256": "b" * 64}
    return {**head, "protocol": "honest", "submissions": [submission], "rows": rows, **changed}


@pytest.fixture
def ours():
    return results("ours", [row("first", "fdk", 20.0), row("second", "fdk", 30.0), row("first", "mine", 25.0)])


def test_the_mean_stands_only_where_no_case_is_missing(ours):
    lines = [[cell.strip() for cell in line.strip("|").split("|")] for line in summary_table(ours).splitlines()]
    assert lines[0] == ["method", "first", "second", "mean"]
    assert lines[2:] == [["fdk, 30 s", "20.00", "30.00", "25.00"], ["mine, 30 s", "25.00", "-", "-"]]


def test_methods_of_two_submissions_keep_apart(ours):
    theirs = results("theirs", [row("first", "fdk", 21.0), row("first", "deep", 40.0)])
    both = merged([ours, theirs])
    assert list(mean_levels(both)) == ["fdk [ours], 30 s", "mine, 30 s", "fdk [theirs], 30 s", "deep, 30 s"]
    assert [one["submission"] for one in both["rows"]] == [0, 0, 0, 1, 1]
    assert [one["label"] for one in both["submissions"]] == ["ours", "theirs"]
    twice = merged([ours, ours])
    assert list(mean_levels(twice))[:2] == ["fdk [ours, 1], 30 s", "mine [ours, 1], 30 s"]


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"suite": "v2"}, "only results on the same scans can be merged, got suite v1 and v2"),
        ({"tier": "hour"}, "got tier minutes and hour"),
        ({"sha256": "f" * 64}, "got hash bbbbbbbbbbbb and ffffffffffff"),
    ],
)
def test_other_scans_are_not_merged(ours, changed, sentence):
    with pytest.raises(InputError, match=sentence):
        merged([ours, results("theirs", [], **changed)])


def test_the_page_has_hashes_versions_and_errors(ours):
    text = page({**ours, "rows": [*ours["rows"], row("second", "mine", None)]})
    assert "# Suite v1, tier minutes, bbbbbbbbbbbb" in text
    assert "`" + "b" * 64 + "`" in text
    assert "Counts `cccccccccccc`, compared with the stored ones: identical." in text
    assert "- mine, 30 s: it did not converge." in text
    assert "- ours: scored by spectral-ct 0.1.0; processor time, 1 thread(s); numpy 2.0." in text


def test_the_csv_has_a_line_per_volume_with_the_hashes(ours, tmp_path):
    write_csv(tmp_path / "table.csv", {**ours, "rows": [*ours["rows"], row("second", "mine", None)]})
    with (tmp_path / "table.csv").open(encoding="utf-8") as file:
        lines = list(csv.DictReader(file))
    assert [line["psnr"] for line in lines] == ["20.0", "30.0", "25.0", ""]
    assert {line["sha256"] for line in lines} == {"b" * 64}
    assert {line["counts_sha256"] for line in lines} == {"c" * 64}
    assert lines[-1]["error"] == "it did not converge"


def test_the_figure_is_drawn_where_there_is_a_number(ours, tmp_path):
    assert cases_and_methods({**ours, "rows": [row("first", "mine", None)]}, tmp_path / "none.png") is None
    assert cases_and_methods(ours, tmp_path / "some.png") == tmp_path / "some.png"
    assert [path.name for path in tmp_path.iterdir()] == ["some.png"]


def test_results_are_read_from_a_folder_or_a_file_and_nothing_else(ours, tmp_path):
    (tmp_path / "suite-score.json").write_text(json.dumps(ours))
    assert read_results(tmp_path) == read_results(tmp_path / "suite-score.json") == ours
    with pytest.raises(InputError, match=r"there is no .*missing: `recon suite score` writes it"):
        read_results(tmp_path / "missing")
    for text in ("{", "[]", '{"schema": "other"}'):
        (tmp_path / "suite-score.json").write_text(text)
        with pytest.raises(InputError, match=r"suite-score\.json holds no results of a suite"):
            read_results(tmp_path)
