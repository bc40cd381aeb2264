"""What a run says of itself: a sentence where a check failed, none where there is nothing to say."""

import json
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from support.tiny_scans import make

import recon
from phantomgen.dataset.reader import open_dataset
from phantomgen.dataset.truth import read_truth
from phantomgen.geometry.voxel_grid import Grid
from recon.cli.main import main
from recon.data.coverage import Coverage, coverage, inner_box
from recon.data.measurements import read_measurements
from recon.evaluation.scoring import score_fitted_views
from recon.evaluation.verdict import (
    FitOutcome,
    bases_left_out,
    few_views,
    limited_angle,
    lines,
    misfit,
    record,
    starved,
    truncated,
    verdict_of,
)
from recon.gaussians.recipe import Stage
from recon.output.report.page import run_report
from recon.voxel.iterative.one_step import OneStep
from recon.voxel.model import Voxels

GRID = Grid.cube(16, 128.0)
WHOLE = Coverage((0.0,) * 4, 0.0, 0.0, 0.0, 0.0, 20, GRID)
GOOD = {"chi_square_away": 1.1, "rays_away": 10_000, "counts_away": 1000.0}
SHORT = recon.Recipe(stages=(Stage(1.0, 1.0),), voxel_passes=2, approximation=5)
NARROW = ("--set", "panel={rows: 32, columns: 16, pitch: 6.4}")


def ball(voxels):
    z, y, x = np.indices((voxels,) * 3) - (voxels - 1) / 2
    return (x**2 + y**2 + z**2 < (0.4 * voxels) ** 2).astype(np.float32)[None]


def covered(path):
    with open_dataset(path) as dataset:
        return coverage(read_measurements(dataset, dataset.splits["train"]), dataset.grid), dataset.grid


@pytest.fixture(scope="module")
def scans(tmp_path_factory):
    folder = tmp_path_factory.mktemp("scans")
    views = ("--views", "20", "--test-views", "2")
    return {
        "whole": make(folder / "whole.h5", *views),
        "both": make(folder / "both.h5", *views, *NARROW),
        "off-centre": make(
            folder / "off.h5", *views, *NARROW,
            "--set", "objects=[{type: cylinder, material: soft_tissue, radius: 20, length: 60, center: [25, 0, 0]}]",
        ),
        "half-fan": make(folder / "half.h5", *views, "--set", f"panel={panel(28, 30.0)}"),
        "half-fan, short": make(
            folder / "short.h5", *views, "--set", f"panel={panel(28, 30.0)}", "--set", "geometry.arc=200"
        ),
        "grid": make(folder / "grid.h5", *views, "--set", "volume={voxels: 10, size: 80}"),
        "axial": make(
            folder / "axial.h5", *views, "--set", "objects=[{type: cylinder, material: soft_tissue, radius: 25, "
            "length: 300}]", "--set", "panel={rows: 16, columns: 32, pitch: 6.4}",
            "--set", "volume={voxels: 16, size: 64}",
        ),
    }  # fmt: skip


def panel(columns, shift):
    return f"{{rows: 32, columns: {columns}, pitch: 6.4, offset: {{columns: {shift}}}}}"


def test_a_good_run_has_nothing_to_say():
    assert verdict_of(FitOutcome({"bin0": GOOD}, 0.02, ball(16), 20, ["a"], ["a"], WHOLE)) == ()


def test_a_run_without_test_views_says_that_nothing_was_checked():
    (said,) = verdict_of(FitOutcome({}, 0.02, ball(16), 20, ["a"], ["a"], WHOLE))
    assert said.key == "unchecked"
    assert not said.failed
    assert lines({"verdict": record((said,))})[-1].endswith("rays beside those of the fit were not checked.")


def test_a_run_that_does_not_even_explain_what_it_was_fitted_to_fails():
    bad = {"bin0": GOOD | {"chi_square_away": 600.0}, "bin1": GOOD}
    said = verdict_of(FitOutcome({}, 0.02, ball(16), 20, ["a"], ["a"], WHOLE, fitted_channels=bad))
    assert [remark.key for remark in said] == ["misfit", "unchecked"]
    assert "the views that it was fitted to: away from edges chi-square is 600 in bin0," in said[0].sentence
    good = FitOutcome({}, 0.02, ball(16), 20, ["a"], ["a"], WHOLE, fitted_channels={"bin0": GOOD})
    assert [remark.key for remark in verdict_of(good)] == ["unchecked"]


def test_fitted_views_tell_a_failure_from_the_truth(tmp_path):
    with open_dataset(make(tmp_path / "alone.h5", "--views", "9", "--test-views", "0", voxels=64)) as dataset:
        truth = read_truth(dataset.path)
        for part, fails in ((1.0, False), (0.9, True)):
            model = Voxels((part * truth.volumes).astype(np.float32), truth.grid, truth.basis_names)
            assert (misfit(score_fitted_views(dataset, model), 0.02) is not None) == fails


def test_every_fault_has_its_key_and_says_what_to_do():
    bad = replace(WHOLE, lateral=1.0, sides=(1.0, 0.0, 0.0, 0.0), outside=0.2, starved=0.1, unseen=0.6)
    channels = {"bin0": GOOD | {"chi_square_away": 774.0}, "bin1": GOOD}
    notes = ["The fit is less likely than its start."]
    said = verdict_of(FitOutcome(channels, 0.02, ball(64), 5, ["a"], ["a", "b"], bad, notes=notes))
    assert [r.key for r in said] == [
        "truncated", "outside_grid", "starved", "limited_angle", "misfit", "few_views", "bases_left_out", "note"
    ]  # fmt: skip
    assert [r.key for r in said if not r.failed] == ["bases_left_out"]
    assert "60 % of all directions" in said[3].sentence
    assert "774 in bin0" in said[4].sentence
    assert "bin1" not in said[4].sentence
    assert all(remark.sentence.endswith(".") for remark in said)
    assert json.loads(json.dumps(record(said)))[0]["key"] == "truncated"


def test_chi_square_may_exceed_one_by_its_own_error_and_by_what_the_recipe_concedes():
    assert misfit({"a": GOOD | {"chi_square_away": 1.4 * (1 - 1e-3)}}, 0.02) is None
    assert misfit({"a": GOOD | {"chi_square_away": 1.6}}, 0.02) is not None
    assert misfit({"a": GOOD | {"chi_square_away": 1.6, "rays_away": 30}}, 0.02) is None
    assert misfit({"a": GOOD | {"chi_square_away": 1.6, "counts_away": 5000.0}}, 0.02) is None
    assert misfit({"a": GOOD | {"chi_square_away": None}}, 0.02) is None


def test_views_are_few_for_a_grid_that_is_fine():
    assert few_views(ball(64), 45) is None
    assert few_views(ball(64), 10) is not None
    assert few_views(ball(16), 10) is None
    assert few_views(0 * ball(16), 1) is None


def test_what_is_not_there_is_not_said():
    assert truncated(WHOLE) is None
    assert starved(replace(WHOLE, starved=0.005)) is None
    assert limited_angle(replace(WHOLE, unseen=0.03)) is None
    assert bases_left_out(["a", "b"], ["a", "b"]) is None


def test_a_scan_of_the_whole_object_keeps_its_grid(scans):
    found, grid = covered(scans["whole"])
    assert found.grid == grid
    assert (found.lateral, found.axial, found.outside, found.sides) == (0, 0, 0, (0, 0, 0, 0))


def test_an_object_that_leaves_the_panel_or_the_grid_gets_a_margin(scans):
    both, _ = covered(scans["both"])
    assert both.lateral == 1
    assert both.axial == 0
    assert both.sides == (1, 1, 0, 0)
    outside, small = covered(scans["grid"])
    assert outside.outside > 0.05
    assert outside.lateral == 0
    assert np.array(outside.grid.shape)[1:] * outside.grid.spacing[0] == pytest.approx(100, abs=2 * 12)  # radius 50
    assert outside.grid.part(inner_box(small, outside.grid)).shape == small.shape
    np.testing.assert_allclose(outside.grid.part(inner_box(small, outside.grid)).origin, small.origin)


def test_an_object_that_leaves_the_panel_in_some_views_is_truncated_in_those(scans):
    found, _ = covered(scans["off-centre"])
    assert 0 < found.lateral < 1
    assert found.axial == 0


def test_an_object_that_is_longer_than_the_grid_gets_a_margin_along_the_axis(scans):
    found, grid = covered(scans["axial"])
    assert found.axial == 1
    assert found.lateral == 0
    assert found.grid.shape[0] > grid.shape[0]
    assert found.grid.shape[1:] == grid.shape[1:]


def test_a_panel_beside_the_axis_is_no_truncation_where_its_far_side_sees_the_border(scans):
    found, _ = covered(scans["half-fan"])
    assert found.lateral == 0
    assert found.sides[0] + found.sides[1] > 0


def test_a_panel_beside_the_axis_is_truncation_where_no_opposite_view_makes_up_for_it(scans):
    found, grid = covered(scans["half-fan, short"])
    assert 0.3 < found.lateral < 1
    assert found.grid == grid


@pytest.mark.slow
def test_a_fit_of_a_truncated_scan_says_so(scans, tmp_path):
    fit = recon.fit(scans["both"], SHORT, bases=3)
    assert "truncated" in [remark.key for remark in fit.verdict]
    folder = fit.save(tmp_path / "run")
    metrics = json.loads((folder / "metrics.json").read_text(encoding="utf-8"))
    assert metrics["verdict"][0]["key"] == "truncated"
    page = run_report([folder], scans["both"])
    assert page.sections[0].title == "Verdict"


@pytest.mark.parametrize(("scan", "code"), [("both", 3), ("whole", 0)])
def test_strict_turns_a_failed_check_into_an_exit_code(scans, tmp_path, scan, code):
    options = ["-q", "--no-figures", "--method", "sirt", "--sweeps", "2", "-o", str(tmp_path / "run")]
    result = CliRunner().invoke(main, ["fit", str(scans[scan]), *options])
    assert result.exit_code == 0, result.output
    strict = CliRunner().invoke(main, ["fit", str(scans[scan]), *options, "--overwrite", "--strict"])
    metrics = json.loads((tmp_path / "run" / "metrics.json").read_text(encoding="utf-8"))
    said = metrics["verdict"]
    assert ("psnr_elsewhere" in metrics["basis"]["compton"]) == (scan == "both")
    assert strict.exit_code == (3 if any(r["failed"] for r in said) else 0), strict.output
    assert ("truncated" in [r["key"] for r in said]) == (code == 3)


def test_what_lies_beyond_the_grid_no_longer_spoils_what_lies_within(scans):
    """Compton of one-step in a cylinder that all views see, against the truth."""
    with open_dataset(scans["grid"]) as dataset:
        measured = read_measurements(dataset, dataset.splits["train"], 3).without_partial_volume()
        grid, truth = dataset.grid, read_truth(scans["grid"])
    inside = np.hypot(*np.meshgrid(grid.axis("y"), grid.axis("x"), indexing="ij")) < 34
    errors = []
    for working in (grid, coverage(measured, grid).grid):
        found = OneStep(levels=((1, 8),)).reconstruct_counts(measured, working)[:, *inner_box(grid, working)]
        off = (found[1] - truth.volumes[1])[2:-2, inside]
        errors.append(np.sqrt(np.mean(off**2)) / truth.volumes[1].max())
    assert errors[1] < 0.5 * errors[0]
