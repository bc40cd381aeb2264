"""No contrast agent in metal, and agents wherever else they are."""

from dataclasses import replace

import numpy as np
import pytest
from support.gaussian_scenes import NAMES, PIXEL, circular, small_model, small_scan, spectral_model

from phantomgen.geometry.voxel_grid import Grid
from recon.data.volume_edges import metal_without_agents
from recon.gaussians.optimize import fit
from recon.gaussians.recipe import Recipe, Stage
from recon.gaussians.voxel_prior import VoxelPrior
from recon.voxel.iterative.one_step import OneStep, _metric

GRID = Grid.cube(12, 12.0)
TISSUE = np.array([0.002, 0.018, 0.0])[:, None, None, None]


def volumes(*held):
    """Tissue, and a rod through it that holds so much of each basis."""
    out = np.broadcast_to(TISSUE, (3, *GRID.shape)).astype(np.float32).copy()
    out[:, :, 5:7, 5:7] = np.array(held)[:, None, None, None]
    return out


def test_metal_is_dense_in_bases_that_are_no_edges():
    edges, over = metal_without_agents(volumes(0.3, 0.08, 0.0), NAMES)
    assert list(edges) == [False, False, True]
    assert over[6, 6, 6] == pytest.approx(0.38 / 0.02 / 3, rel=1e-3)
    assert over[6, 1, 1] == 1
    assert (metal_without_agents(volumes(0.002, 0.018, 0.5), NAMES)[1] == 1).all()  # an agent, not metal
    assert (metal_without_agents(volumes(0.3, 0.08, 0.0)[:1], NAMES[2:])[1] == 1).all()


def test_voxels_of_metal_have_a_prior_without_agents():
    scan = small_scan(small_model(1), circular(16, 16, views=9), spectral_model(3))
    found = _metric(volumes(0.3, 0.08, 0.0), scan, GRID, OneStep()).empty
    assert found is not None
    assert (found[2, :, 5:7, 5:7] > 0).all()
    assert not found[:2].any()
    assert not found[2, :, :3].any()
    assert _metric(volumes(0.002, 0.018, 0.5), scan, GRID, OneStep()).empty is None


def test_a_fit_leaves_agents_in_metal_as_the_voxels_have_them():
    truth = small_model(1)
    scan = small_scan(truth, circular(16, 16, views=9), spectral_model(3), seed=3)
    start = replace(truth, coefficients=0.8 * truth.coefficients)
    prior = VoxelPrior(volumes(0.3, 0.08, 0.0), GRID, 1e-9, np.ones(GRID.shape, np.float32)).holding_kedges(NAMES)
    held = prior.held_coefficients(start)
    assert held is not None
    assert 0 < held.sum() < len(truth)
    recipe = Recipe(stages=(Stage(1.0, 2.0),), centre_rate=1e-9, shape_rate=1e-9)
    moved = (fit(start, scan, PIXEL, recipe, prior=prior).coefficients - start.coefficients).abs()
    assert float(moved[held].max()) < 1e-3 * float(moved[~held].max())
