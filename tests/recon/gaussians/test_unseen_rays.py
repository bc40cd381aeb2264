"""Rays that are set apart are seen by no fit, and tell which model is more likely."""

from dataclasses import replace

import numpy as np
import pytest
from support.gaussian_scenes import PIXEL, circular, small_model, small_scan, spectral_model

from phantomgen.geometry.voxel_grid import Grid
from recon.data.pixel_blocks import touched
from recon.gaussians.likelihood import likelihood_and_gradients
from recon.gaussians.unseen_rays import DEFAULT, UnseenRays, certainly_larger, with_unseen_rays
from recon.voxel.iterative.likelihood import deviance_and_gradient
from recon.voxel.model import Voxels

VOXEL = PIXEL / 2  # blocks of two pixels
GRID = Grid.cube(24, 24.0)


@pytest.fixture(scope="module")
def scan():
    """A model and a scan of it, with rays apart."""
    truth = small_model(1)
    measured = small_scan(truth, circular(16, 16, views=12), spectral_model(3), seed=3)
    return truth, with_unseen_rays(measured, VOXEL, seed=0)


def test_one_ray_of_64_is_apart_in_eight_views(scan):
    apart = scan[1].unseen_blocks
    assert apart.shape == (12, 8, 8)
    assert apart.any(axis=(1, 2)).sum() == 8
    assert apart.mean() == pytest.approx(DEFAULT.part, rel=0.4)


def test_the_seed_decides_which(scan):
    again, other = (with_unseen_rays(scan[1], VOXEL, seed).unseen_blocks for seed in (0, 1))
    assert again is not None
    assert other is not None
    assert (again == scan[1].unseen_blocks).all()
    assert (again != other).any()


@pytest.mark.parametrize("pixels", [4, 6, 8, 12])
def test_a_pixel_is_touched_where_a_part_of_it_lies_in_a_block(pixels):
    blocks = np.random.default_rng(0).random((4, 4)) < 0.3
    fine = blocks.repeat(6, axis=0).repeat(6, axis=1)
    size = 24 // pixels
    expected = fine.reshape(pixels, size, pixels, size).any(axis=(1, 3))
    assert np.array_equal(touched(blocks, pixels, pixels), expected)


def test_no_fit_sees_counts_that_are_apart(scan):
    truth, measured = scan
    spoilt = measured.counts.copy()
    views, rows, columns = np.nonzero(measured.unseen_blocks.repeat(2, axis=1).repeat(2, axis=2))
    spoilt[views, :, rows, columns] *= 1.5
    volumes = truth.volume(GRID)
    found = []
    for counts in (measured.counts, spoilt):
        data = replace(measured, counts=counts).weighted(0.02)
        some = replace(data, statistical_weights=np.where(data.statistical_weights > 0, np.float32(1), np.float32(0)))
        model = truth.detached()
        for part in model.tensors().values():
            part.requires_grad_()
        deviance = likelihood_and_gradients(model, some, np.arange(12), 0.02).deviance
        found.append((deviance, deviance_and_gradient(volumes, some, GRID, 0.02)[0]))
    assert found[0] == pytest.approx(found[1], rel=1e-6)


def test_a_spoilt_fit_is_told_and_left_out(scan):
    truth, measured = scan
    rays = UnseenRays.of(measured, VOXEL, 0.02)
    spoilt = replace(truth, coefficients=1.1 * truth.coefficients)
    start = Voxels(truth.volume(GRID), GRID, truth.basis_names)
    kept, notes = rays.better_of(truth, spoilt, start)
    assert kept is truth
    assert "before the fit are kept" in notes[0]
    kept, notes = rays.better_of(spoilt, truth, Voxels(1.1 * start.values, GRID, truth.basis_names))
    assert kept is truth
    assert notes == ()
    kept, notes = rays.better_of(spoilt, spoilt, start)
    assert kept is spoilt
    assert len(notes) == 1
    assert "volumes.h5" in notes[0]


def test_a_difference_counts_when_it_is_more_than_chance():
    noise = 5 + np.random.default_rng(0).normal(size=8)
    assert certainly_larger(noise + 1, noise)
    assert not certainly_larger(noise, np.zeros(8) + noise.mean())
    assert not certainly_larger(np.ones(1), np.zeros(1))


@pytest.mark.parametrize("largest", [1e3, 1e40, np.inf, np.nan])
def test_a_fit_that_diverged_is_worse_though_one_view_holds_nearly_all_of_the_difference(largest):
    start = np.full(8, 5.0)
    diverged = 10.0 ** np.arange(8)
    diverged[0] = 6
    diverged[-1] = largest
    assert certainly_larger(diverged, start)
    assert not certainly_larger(start, diverged)
