"""Voxels whose bases the counts do not tell: which are marked, and what scores and the verdict make of them."""

import json
from dataclasses import replace

import h5py
import numpy as np
import pytest
from click.testing import CliRunner
from support.gaussian_scenes import NAMES, circular, small_model, small_scan, spectral_model
from support.tiny_scans import make

from phantomgen.geometry.voxel_grid import Grid
from recon.cli.main import main
from recon.evaluation.metrics import HeldOutView, score_elsewhere, score_projections
from recon.evaluation.verdict import misfit_marked
from recon.output.report.page import run_report
from recon.voxel.iterative.likelihood import forward
from recon.voxel.unreliable import METAL, STARVED, relative_deviations, sentence, unreliable_voxels

GRID = Grid.cube(12, 12.0)
TISSUE = (0.002, 0.018, 0.0)
ROD = (slice(None), slice(5, 7), slice(5, 7))


def volumes(*held):
    """Tissue, and a rod through it that holds so much of each basis."""
    out = np.broadcast_to(np.array(TISSUE)[:, None, None, None], (3, *GRID.shape)).astype(np.float32).copy()
    out[:, *ROD] = np.array(held)[:, None, None, None]
    return out


def scan_of(values):
    """Expected counts of voxels."""
    geometry = circular(16, 16, views=9)
    scan = small_scan(small_model(1), geometry, spectral_model(3))
    lengths = np.moveaxis(forward(values, geometry, GRID), 0, -1)
    return replace(scan, counts=np.moveaxis(scan.transmission.expected(lengths), -1, 1).astype(np.float32))


def test_metal_and_what_is_next_to_it_are_marked_and_nothing_else():
    metal = volumes(0.3, 0.08, 0.0)
    found = unreliable_voxels(metal, scan_of(metal), GRID, 0.02)
    assert found is not None
    expected = np.zeros(GRID.shape, bool)
    expected[:, 4:8, 4:8] = True
    np.testing.assert_array_equal((found.flags & METAL) > 0, expected)
    record = found.record()
    assert (record["voxels"], record["metal"], record["places"]) == (192, 192, 1)
    assert record["part"] == pytest.approx(192 / 12**3)
    assert record["largest_mm"]["x"] == [-1.5, 1.5]
    said = sentence(record)
    assert "192 voxels (11 %" in said
    assert "x -1.5 to 1.5 mm" in said
    assert "metal" in said
    assert "photon" not in said


def test_tissue_and_contrast_agents_are_not_marked():
    for held in (TISSUE, (0.002, 0.018, 0.05), (0.017, 0.032, 0.0)):
        assert unreliable_voxels(volumes(*held), scan_of(volumes(*held)), GRID, 0.02) is None
    assert unreliable_voxels(0 * volumes(*TISSUE), scan_of(volumes(*TISSUE)), GRID, 0.02) is None


def test_what_hardly_a_photon_passes_is_marked_though_it_is_no_metal():
    dark = volumes(*TISSUE)
    dark[:, :, 3:9, 3:9] = np.array([0.3, 0.5, 0.0])[:, None, None, None]
    scan = replace(scan_of(dark), basis_names=("kedge_I", "kedge_Gd", "kedge_Au"))  # which metal is not told by
    found = unreliable_voxels(dark, scan, GRID, 0.02)
    assert found is not None
    starved = (found.flags & STARVED) > 0
    assert starved[3:9, 4:8, 4:8].all()
    assert not starved[:, :2].any()
    assert not (found.flags & METAL).any()
    assert "hardly any photon" in sentence(found.record())


def test_slabs_of_voxels_are_as_the_whole(monkeypatch):
    dense = volumes(0.3, 0.5, 0.0)
    scan, held = scan_of(dense), np.ones(GRID.shape, bool)
    whole = relative_deviations(dense, held, scan, GRID, 0.02)
    monkeypatch.setattr("recon.voxel.unreliable.SLAB_VALUES", 5 * 9 * 12**2)
    np.testing.assert_array_equal(relative_deviations(dense, held, scan, GRID, 0.02), whole)


def test_scores_elsewhere_leave_marked_voxels_out():
    truth = volumes(0.3, 0.08, 0.0)
    found = truth + np.float32(1e-3)
    found[:, *ROD] += 1
    marked = np.zeros(GRID.shape, bool)
    marked[ROD] = True
    scores = score_elsewhere(found, truth, NAMES, marked)
    assert scores["compton"]["rmse_elsewhere"] == pytest.approx(1e-3, rel=1e-3)
    assert scores["compton"]["bias_elsewhere"] == pytest.approx(1e-3, rel=1e-3)
    assert scores["compton"]["psnr_elsewhere"] == pytest.approx(20 * np.log10(18), abs=1e-2)
    assert scores["kedge"]["psnr_elsewhere"] is None
    assert score_elsewhere(found, truth, NAMES, np.ones_like(marked))["compton"]["rmse_elsewhere"] is None


def test_chi_square_of_marked_rays_is_that_of_these():
    counts, expected = np.full((1, 2, 2), 100.0), np.full((1, 2, 2), 100.0)
    counts[0, 0, 0] = 150
    away, marked = np.zeros((2, 2), bool), np.zeros((2, 2), bool)
    marked[0] = True
    view = HeldOutView(counts, expected, 10 * expected, away, marked)
    score = score_projections([view], ("only",))["only"]
    assert score["chi_square_marked"] == pytest.approx(12.5)
    assert (score["rays_marked"], score["counts_marked"]) == (2, 100)
    assert "chi_square_marked" not in score_projections([replace(view, marked=None)], ("only",))["only"]


def test_marked_rays_that_are_not_explained_are_named():
    marked = {"voxels": 24, "metal": 24, "starved": 0}
    score = {"chi_square_marked": 24.0, "rays_marked": 3000, "counts_marked": 5000.0}
    said = misfit_marked({"bin0": score, "bin1": score | {"chi_square_marked": 1.1}}, marked, 0.02)
    assert said is not None
    assert said.failed
    assert "24 voxels of metal" in said.sentence
    assert "24 (bin0)" in said.sentence
    assert misfit_marked({"bin0": score | {"chi_square_marked": 3.1}}, marked, 0.02) is None
    assert misfit_marked({"bin0": {"chi_square_away": 100.0}}, marked, 0.02) is None


@pytest.mark.slow
def test_a_run_scores_with_and_without_the_metal_and_says_so(tmp_path):
    scan = make(
        tmp_path / "scan.h5", "--views", "12", "--test-views", "2",
        "--set", "materials.steel={coefficients: {photoelectric: 0.6, compton: 0.09}}",
        "--set", "objects=[{type: cylinder, material: soft_tissue, radius: 50, length: 100}, "
        "{type: cylinder, material: steel, center: [10, 0, 0], radius: 8, length: 80}]",
    )  # fmt: skip
    options = ["-q", "--no-figures", "--method", "sirt", "--sweeps", "8", "-o", str(tmp_path / "run")]
    result = CliRunner().invoke(main, ["fit", str(scan), *options])
    assert result.exit_code == 0, result.output
    assert "elsewhere" in result.stdout
    assert "The counts do not determine the bases" in result.stdout
    metrics = json.loads((tmp_path / "run" / "metrics.json").read_text(encoding="utf-8"))
    with h5py.File(tmp_path / "run" / "volumes.h5") as file:
        flags = file["unreliable/data"][()]
        assert list(file["unreliable"].attrs["axes"]) == ["z", "y", "x"]
    assert np.count_nonzero(flags) == metrics["unreliable"]["voxels"] > 0
    assert {"psnr", "psnr_elsewhere", "rmse_elsewhere"} <= set(metrics["basis"]["compton"])
    assert metrics["basis"]["photoelectric"]["rmse_elsewhere"] < metrics["basis"]["photoelectric"]["rmse"]
    assert metrics["channels"]["bin0"]["rays_marked"] > 0
    assert {"unreliable", "misfit_marked"} <= {remark["key"] for remark in metrics["verdict"]}
    scores = run_report([tmp_path / "run"], scan).sections[1].parts[0]
    assert "PSNR elsewhere [dB]" in scores.header
