"""Tables, CSV, requirements and the figure, from results made by hand."""

import csv

import pytest

from recon.comparison.contenders.contender import contenders
from recon.comparison.outcome import requirements
from recon.comparison.tables.figure import _ends, _lines, error_against_time
from recon.comparison.tables.table import (
    markdown_table,
    mean_psnr,
    methods_ahead,
    remarks,
    report,
    run_table,
    write_csv,
)


def result(who, budget, psnrs, seconds=1.0, **more):
    """Scores of two bases, None for a basis without any."""
    scores = {
        name: {} if value is None else {"psnr": value, "psnr_scaled": value + 1, "psnr_zero": 9.0, "ssim": 0.9}
        for name, value in zip(("photoelectric", "compton"), psnrs, strict=True)
    }
    views = {"honest": {"low": {"psnr": 40.0, "ssim": 0.95, "lpips": None}}}
    curve = [
        {"seconds": seconds * part, "done": part} | {f"psnr_{n}": s["psnr"] - 1 / part for n, s in scores.items() if s}
        for part in (0.5, 1.0)
    ]
    return {
        "contender": who, "budget": budget, "seconds": seconds, "done": 4, "total": 8, "finished": False,
        "primitives": 7, "kind": "voxels", "peak_memory_mib": 300.0, "curve": curve, "views": views,
        "chi_square": {"low": {"all": 4.0, "away": 1.1}}, "energies": {}, "basis": {"honest": scores},
        "materials": {"bone": {"voxels": 5, "compton": {"true": 0.02, "mean": 0.021, "bias": 1e-3, "sd": 5e-4}}},
    } | more  # fmt: skip


OURS = result("gaussian", 10.0, (40.0, 30.0))
AHEAD = result("one-step", 10.0, (39.0, 33.5), seconds=3.0)
HALF = result("sart+2", 10.0, (35.0, None))
FAILED = {"contender": "fdk", "budget": 10.0, "error": "the views are not evenly spaced"}
ALL = [OURS, AHEAD, HALF, FAILED]


def test_a_table_has_columns_of_equal_width():
    lines = markdown_table(["name", "n"], [["a", "1"], ["long name", "22"]]).splitlines()
    assert lines == ["| name      |  n |", "| --------- | -: |", "| a         |  1 |", "| long name | 22 |"]


def test_the_report_shows_scores_dashes_and_failures():
    text = report(ALL, "honest", "title")
    assert "| gaussian, 10 s |     35.00 |" in text
    assert "the views are not evenly spaced" in text
    assert "+1.000 ± 0.500" in text
    half = next(line for line in text.splitlines() if line.startswith("| sart+2, 10 s") and "35.00" in line)
    assert half.count(" - ") == 4  # three scores of Compton, and the mean
    assert "4 of 8 (stopped by the budget)" in text


@pytest.mark.parametrize(
    ("seconds", "finished", "words"),
    [
        (3.0, True, "4 of 8 (stopped by itself after 3 of 10 s)"),
        (9.7, True, "4 of 8 |"),
        (9.9, False, "4 of 8 (stopped by the budget)"),
    ],
)
def test_a_run_that_did_not_use_its_budget_says_so(seconds, finished, words):
    assert words in run_table([OURS | {"seconds": seconds, "finished": finished}])


def test_the_report_shows_material_maps():
    maps = {"dice": {"bone": 0.91}, "mean_dice": 0.91, "rgb_views": {"psnr": 41.0, "ssim": 0.99}, "rgb_slices": {}}
    text = report([OURS | {"maps": maps}, AHEAD], "honest", "title")
    assert "| gaussian, 10 s |     0.910 | 0.910 |      41.00 |      0.990 |           - |           - |" in text
    assert "Dice" not in report(ALL, "honest", "title")


def test_the_report_says_which_methods_are_ahead_of_the_gaussians():
    assert methods_ahead(ALL, "honest") == [
        "- 10 s, photoelectric: no method is ahead.",
        "- 10 s, Compton: ahead are one-step by 3.50 dB.",
    ]


def test_means_exist_where_all_their_parts_do():
    assert mean_psnr(OURS, "basis", "honest") == 35.0
    assert mean_psnr(HALF, "basis", "honest") is None
    assert mean_psnr(FAILED, "basis", "honest") is None


@pytest.mark.parametrize(
    ("word", "sentences"),
    [
        ("sart+2", ["gaussian cannot be compared with sart+2 at 10 s: sart+2 has no score."]),
        ("one-step", ["gaussian is not above one-step at 10 s: 35.00 dB and 36.25 dB."]),
        ("cgls", []),
    ],
)
def test_requirements_that_are_not_met_are_sentences(word, sentences):
    below = result("cgls", 10.0, (39.0, 20.0))
    no_views = HALF | {"views": {}}
    assert requirements([OURS, AHEAD, no_views, below], contenders([word]), 10.0, "honest") == sentences


def test_without_a_truth_views_decide():
    ours, theirs = (r | {"basis": {}} for r in (OURS, AHEAD))
    theirs["views"] = {"honest": {"low": {"psnr": 41.0}}}
    found = requirements([ours, theirs], contenders(["one-step"]), 10.0, "honest")
    assert found == ["gaussian is not above one-step at 10 s: 40.00 dB and 41.00 dB."]


def test_csv_has_every_number_on_a_line(tmp_path):
    maps = {"dice": {"bone": 0.91}, "mean_dice": 0.91, "rgb_views": {"psnr": 41.0, "lpips": None}, "rgb_slices": {}}
    write_csv(tmp_path / "compare.csv", [*ALL, OURS | {"contender": "paper", "maps": maps}])
    with (tmp_path / "compare.csv").open(newline="", encoding="utf-8") as file:
        lines = list(csv.DictReader(file))
    found = {(x["contender"], x["section"], x["item"], x["metric"]): x["value"] for x in lines}
    assert found["one-step", "basis", "compton", "psnr"] == "33.5"
    assert found["gaussian", "materials", "bone/compton", "bias"] == "0.001"
    assert found["gaussian", "views", "low", "lpips"] == ""
    assert (found["paper", "maps", "bone", "dice"], found["paper", "maps", "rgb_views", "psnr"]) == ("0.91", "41.0")
    assert not any(x["contender"] == "fdk" for x in lines)


def test_the_figure_shows_the_longest_run_and_what_each_budget_ends_with():
    longer = result("gaussian", 40.0, (45.0, 36.0), seconds=4.0)
    assert [p["seconds"] for p in _lines([OURS, longer])["gaussian"]] == [2.0, 4.0]
    assert [p["psnr_compton"] for p in _ends([OURS, longer])["gaussian"]] == [29.0, 35.0]
    cut = result("cgls", 2.0, (30.0, 30.0), seconds=1.0)
    cut["curve"].append({"seconds": 9.0, "psnr_compton": 50.0})  # after the last budget
    assert max(p["seconds"] for p in _lines([cut])["cgls"]) == 1.0


def test_the_figure_needs_a_truth(tmp_path):
    assert error_against_time([OURS | {"curve": []}, FAILED], tmp_path / "none.png", "cpu") is None
    path = error_against_time(ALL, tmp_path / "figure.png", "cpu")
    assert path.read_bytes().startswith(b"\x89PNG")
    header, *rows = path.with_suffix(".csv").read_text().splitlines()
    assert header == "line,seconds,psnr_photoelectric,psnr_compton"
    assert len(rows) == 6


def test_remarks_on_volumes_of_other_programs_stand_once():
    found = [{"contender": "theirs", "remarks": ["check --axes"]}] * 2 + [{"contender": "fdk"}]
    assert remarks(found) == ["- theirs: check --axes."]
