"""Masked pixels: no information for decomposition, fit and scores, and no holes for what starts a fit."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from support.detector_scenes import counting
from support.gaussian_scenes import PIXEL, circular, small_model, small_scan, spectral_model

from phantomgen.dataset.inpainting import inpainted
from phantomgen.dataset.reader import open_dataset
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.simulation.run import simulate
from recon.data.material_decomposition import decompose_views
from recon.data.measurements import read_measurements
from recon.evaluation.metrics import HeldOutView, score_projections
from recon.gaussians.optimize import fit
from recon.gaussians.recipe import Recipe, Stage

GEOMETRY = circular(16, 16, views=9)
MODEL = spectral_model(3)
RECIPE = Recipe(stages=(Stage(1.0, 10.0),))
GRID = Grid.cube(16, 16.0)
TRUTH = small_model(1, count=50)


def bad_pixels(part=0.05):
    return np.random.default_rng(7).random((16, 16)) < part


def spoilt(scan, bad):
    """Hot pixels: they read twice the open beam in every view."""
    hot = 2 * MODEL.open_beam[:, None].astype(np.float32)
    counts = scan.counts.copy()
    counts[:, :, bad] = hot
    return replace(scan, counts=counts)


def masked(scan, bad):
    """What reading makes of a mask."""
    return replace(scan, counts=np.where(bad, 0, scan.counts), gains=np.where(bad, 0, scan.gains))


@pytest.fixture(scope="module")
def scan():
    return small_scan(TRUTH, GEOMETRY, MODEL, seed=3)


def test_reading_gives_masked_pixels_no_weight_and_leaves_the_others_as_they_are(tmp_path):
    few = ["geometry.views=2", "panel.rows=12", "panel.columns=14"]
    defects = "effects.defects={dead: 0.05, hot: 0.05, columns: [3]}"
    read = {}
    for name, more in {"good": [], "bad": [defects], "kept back": [defects, "effects.defects.masked=false"]}.items():
        simulate(counting(*few, *more), tmp_path / f"{name}.h5")
        with open_dataset(tmp_path / f"{name}.h5") as dataset:
            read[name] = read_measurements(dataset, np.arange(2), bases=2)
            mask = dataset.mask if name == "bad" else None
            read[name, "mask"] = mask
    bad = read["bad", "mask"][0]
    assert bad.sum() > 14
    for found in (read["bad"], read["kept back"]):  # stuck pixels show in the darks, dead ones in the flats
        assert not found.gains[:, bad].any()
        assert not found.counts[:, :, bad].any()
        np.testing.assert_array_equal(found.blind_pixels, bad)
        np.testing.assert_array_equal(found.counts[..., ~bad], read["good"].counts[..., ~bad])
        np.testing.assert_array_equal(found.gains[..., ~bad], read["good"].gains[..., ~bad])
    assert not read["good"].blind_pixels.any()


def test_decomposition_of_the_other_rays_is_the_same_and_holes_are_filled(scan):
    bad = bad_pixels()
    whole, holed = decompose_views(scan)[0], decompose_views(masked(spoilt(scan, bad), bad))[0]
    np.testing.assert_array_equal(holed[..., ~bad], whole[..., ~bad])
    lengths = TRUTH.line_integrals(GEOMETRY).numpy()
    noise = np.sqrt(np.mean((whole - lengths) ** 2, axis=(0, 2, 3)))
    error = np.sqrt(np.mean((inpainted(holed, bad) - lengths)[..., bad] ** 2, axis=(0, 2)))
    empty = np.sqrt(np.mean((holed - lengths)[..., bad] ** 2, axis=(0, 2)))
    assert (error < 0.25 * empty + noise).all()


def test_pixels_that_are_masked_in_a_bin_take_their_part_of_its_open_beam_along(scan):
    bad = bad_pixels(0.2)
    binned = masked(scan, bad).binned(2)
    np.testing.assert_array_equal(binned.gains[0], (~bad).reshape(8, 2, 8, 2).sum(axis=(1, 3)))
    np.testing.assert_array_equal(binned.blind_pixels, bad.reshape(8, 2, 8, 2).all(axis=(1, 3)))


def test_a_fit_is_as_good_as_without_defects_which_would_ruin_it(scan):
    shift = torch.from_numpy(np.random.default_rng(2).normal(scale=0.3, size=(50, 3))).float()
    start = replace(TRUTH, centres=TRUTH.centres + shift, coefficients=TRUTH.coefficients.mean().expand(50, 3).clone())
    bad = bad_pixels(0.03)
    errors = []
    for data in (scan, masked(spoilt(scan, bad), bad), spoilt(scan, bad)):
        found = fit(start, data, PIXEL, RECIPE).volume(GRID)
        errors.append(np.sqrt(np.mean((found - TRUTH.volume(GRID)) ** 2)))
    good, left_out, ruined = errors
    assert left_out < 1.15 * good
    assert ruined > 1.5 * good


def test_scores_leave_masked_pixels_out_and_take_none_for_an_edge():
    rng = np.random.default_rng(0)
    bad = bad_pixels()
    expected = np.full((2, 16, 16), 400.0)
    gains = np.where(bad, 0.0, 1.0)
    counts = np.where(bad, 1e6, rng.poisson(expected)).astype(float)
    view = HeldOutView.of(counts, expected * gains, 1000 * gains * np.ones((2, 1, 1)))
    assert view.away.all()
    scores = score_projections([view], ["a", "b"])
    for name in "ab":
        assert scores[name]["chi_square_all"] == pytest.approx(1, abs=5 * np.sqrt(2 / 256))
