import os
from dataclasses import replace
from math import ceil, sqrt

import numpy as np
import pytest
import torch
from scipy.ndimage import map_coordinates
from support.gaussian_scenes import circular, tilted
from support.voxel_scenes import balls, voxel_scan

from phantomgen.geometry.voxel_grid import Grid
from recon.evaluation.metrics import score_volume
from recon.gaussians.unseen_rays import with_unseen_rays
from recon.voxel.iterative.multigrid import MARGIN, coarser, occupied, resampled, sharpened
from recon.voxel.iterative.one_step import OneStep, means_in_metal
from spectra.errors import InputError
from spectra.threads import set_threads

PLAIN = OneStep(levels=((1, 12),), subsets=1, strength=0.0, dispersion=0.0, momentum=False)


@pytest.fixture(scope="module")
def noisy():
    truth, grid = balls()
    return truth, grid, voxel_scan(truth, grid, seed=1)


def decibels(volumes, truth):
    return [score_volume(v, t)["psnr"] for v, t in zip(volumes, truth, strict=True)]


def deviances(method, scan, grid):
    history = []
    volumes = method.reconstruct_counts(scan, grid, lambda i: history.append(i.residual))
    return volumes, np.array(history)


@pytest.mark.parametrize("dispersion", [0.0, 0.02])
def test_without_subsets_and_momentum_the_deviance_never_rises(noisy, dispersion):
    _, grid, scan = noisy
    _, history = deviances(replace(PLAIN, dispersion=dispersion), scan, grid)
    assert (np.diff(history) < 1e-6 * history[:-1]).all()
    assert history[-1] < 0.05 * history[0]


def test_momentum_and_subsets_come_further_in_as_many_passes(noisy):
    _, grid, scan = noisy
    slow, fast = (deviances(m, scan, grid)[1][-1] for m in (PLAIN, replace(PLAIN, momentum=True, subsets=4)))
    assert fast - 0.5 < 0.5 * (slow - 0.5)


@pytest.mark.parametrize("metal", [pytest.param(False, marks=pytest.mark.slow), True])
def test_tensors_give_the_same_volumes(noisy, monkeypatch, metal):
    """Kernels of Triton, in its interpreter or on a GPU, beside those of numba."""
    pytest.importorskip("triton")
    truth, grid, _ = noisy
    if metal:
        truth = truth.copy()
        truth[:, 6:9, 6:9, 6:9] *= 12
    scan = voxel_scan(truth, grid, views=4, pixels=8, seed=1)
    # Few steps, as interpreted kernels of the total variation take half a second each.
    method, device = (
        OneStep(levels=((1, 1),), subsets=2, dual_steps=1),
        "cuda" if os.environ["TRITON_INTERPRET"] == "0" else "cpu",
    )
    wanted = method.reconstruct_counts(scan, grid)
    monkeypatch.setattr(
        "recon.voxel.iterative.one_step._on_device", lambda values, settings: torch.from_numpy(values.copy()).to(device)
    )
    found = replace(method, device=device).reconstruct_counts(scan, grid)
    assert np.abs(found - wanted).max() < 1e-3 * np.abs(wanted).max()


def test_few_views_are_passed_over_more_often(noisy):
    _, grid, scan = noisy
    heard = []
    replace(PLAIN, levels=((1, 3),)).reconstruct_counts(scan, grid, heard.append)
    assert [i.total for i in heard] == [ceil(3 * sqrt(75 / len(scan)))] * len(heard)
    assert len(heard) == heard[0].total > 3


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_no_voxel_grows_beyond_what_few_views_with_gaps_measure(seed):
    truth, grid = balls()
    scan = with_unseen_rays(voxel_scan(truth, grid, views=6, seed=seed), 1.0, seed)
    found = OneStep().reconstruct_counts(scan, grid)
    assert (found.max(axis=(1, 2, 3)) < 1.3 * truth.max(axis=(1, 2, 3))).all()


def test_of_many_views_a_few_passes_come_as_far():
    truth, grid = balls()
    few, many = (voxel_scan(truth, grid, views=views, photons=1e5) for views in (75, 300))
    (found, short), (same, long) = (deviances(OneStep(), scan, grid) for scan in (many, few))
    assert len(short) <= (len(long) + 6) // 3
    assert np.mean(decibels(found, truth)) > np.mean(decibels(same, truth))


@pytest.mark.parametrize("bases", [1, 2, 3])
def test_exact_counts_give_the_truth(bases):
    truth, grid = balls(bases=bases)
    method = OneStep(levels=((2, 5), (1, 25)), strength=0.0, dispersion=0.0)
    found = method.reconstruct_counts(voxel_scan(truth, grid, views=16, photons=1e6), grid)
    assert min(decibels(found, truth)) > 32
    assert found.min() >= 0


def test_total_variation_takes_noise_away():
    truth, grid = balls()
    scan = voxel_scan(truth, grid, seed=1, photons=2e3)
    without, with_prior = (replace(OneStep(), strength=s).reconstruct_counts(scan, grid) for s in (0.0, 1.0))
    assert np.mean(decibels(with_prior, truth)) > np.mean(decibels(without, truth)) + 3


def test_any_number_of_threads_gives_the_same_bits(noisy):
    _, grid, scan = noisy
    results = []
    try:
        for threads in (1, 3):
            set_threads(threads)
            results.append(OneStep(levels=((2, 2), (1, 2))).reconstruct_counts(scan, grid))
    finally:
        set_threads(None)
    assert np.array_equal(*results)


def test_views_that_lack_channels_are_used_as_they_are():
    """Tube voltages that change from view to view: every view has half of the channels."""
    truth, grid = balls()
    scan = voxel_scan(truth, grid, views=30, seed=1)
    exposure = scan.exposure.copy()
    exposure[::2, 2:], exposure[1::2, :2] = 0, 0
    counts = scan.counts * (exposure > 0)[:, :, None, None]
    method = OneStep(strength=1.0, dispersion=0.01)
    found = method.reconstruct_counts(replace(scan, counts=counts, exposure=exposure), grid)
    assert np.mean(decibels(found, truth)) > 24


def test_any_orbit_will_do():
    truth, grid = balls(bases=2)
    scan = voxel_scan(truth, grid, geometry=tilted(16, 16, views=10), seed=2)
    assert np.isfinite(OneStep().reconstruct_counts(scan, grid)).all()


def test_the_callback_hears_of_every_pass_and_of_its_grid(noisy, monkeypatch):
    monkeypatch.setattr("recon.voxel.iterative.one_step.FEW_VIEWS", 1)
    _, grid, scan = noisy
    heard = []
    OneStep(levels=((2, 2), (1, 1))).reconstruct_counts(scan, grid, heard.append)
    assert [(i.done, i.total, i.grid.shape[0]) for i in heard] == [(1, 3, 6), (2, 3, 6), (3, 3, 12)]
    assert all(i.volumes.shape[1:] == i.grid.shape and i.residual > 0 for i in heard)


@pytest.mark.parametrize("factor", [1, 2, 3])
def test_linear_volumes_stay_linear_on_other_grids(factor):
    grid = Grid((9, 7, 11), (1.0, 2.0, 0.5), (-3.0, 1.0, 0.0))
    other = coarser(grid, factor)
    ramps = [np.add.outer(np.add.outer(g.axis("z"), 2 * g.axis("y")), 3 * g.axis("x"))[None] for g in (grid, other)]
    found = resampled(ramps[0], grid, other)[0][:-1, :-1, :-1]
    np.testing.assert_allclose(found, ramps[1][0][:-1, :-1, :-1])


def test_the_occupied_box_has_all_that_volumes_hold_and_a_margin():
    volumes = np.zeros((2, 20, 21, 22), np.float32)
    volumes[0, 8:10, 1, 5], volumes[1, 9, 12, 6] = 0.02, 0.001
    volumes[0, 0, 20, 21] = 1e-4  # a speck of noise
    box = occupied(volumes)
    reach = MARGIN + 1  # of the means
    assert box == (slice(8 - reach, 10 + reach), slice(0, 13 + reach), slice(5 - reach, 7 + reach))
    found = Grid((20, 21, 22), (1.0, 2.0, 3.0), (0.0, 5.0, 7.0)).part(box)
    assert found == Grid((10, 17, 10), (1.0, 2.0, 3.0), (4.0, 5.0, 10.0))


def test_soft_tissue_around_gold_is_occupied():
    volumes = np.zeros((1, 30, 30, 30), np.float32)
    volumes[:, 5:25, 5:25, 5:25] = 0.02
    volumes[:, 14:16, 14:16, 14:16] = 7.0
    assert occupied(volumes) == (slice(5 - 1 - MARGIN, 25 + 1 + MARGIN),) * 3


def test_empty_volumes_are_occupied_everywhere():
    assert occupied(np.zeros((1, 4, 5, 6), np.float32)) == (slice(0, 4), slice(0, 5), slice(0, 6))


def test_nothing_is_lost_where_voxels_are_left_out(monkeypatch):
    ball, _ = balls(voxels=12)
    grid = Grid.cube(32, 32.0)
    truth = np.zeros((3, *grid.shape), np.float32)
    truth[:, 6:18, 14:26, 3:15] = ball
    scan = voxel_scan(truth, grid, views=24, pixels=40, geometry=circular(40, 40, 24, 1.6), seed=1)
    found = OneStep().reconstruct_counts(scan, grid)
    monkeypatch.setattr("recon.voxel.iterative.one_step.occupied", lambda volumes: tuple(map(slice, volumes.shape[1:])))
    whole = OneStep().reconstruct_counts(scan, grid)
    assert not found[:, :, :3].any()
    assert np.mean(decibels(found, truth)) > np.mean(decibels(whole, truth)) - 0.5


def test_a_coarser_grid_covers_the_same_box():
    grid = Grid.cube(12, 24.0)
    assert coarser(grid, 3) == Grid.cube(4, 24.0)
    assert coarser(grid, 5).shape == (3, 3, 3)


def test_volumes_from_coarse_voxels_come_closer_to_sharp_edges_and_never_leave_their_range():
    truth, grid = balls(voxels=36)
    coarse = coarser(grid, 2)
    blurred = resampled(resampled(truth, grid, coarse), coarse, grid)
    sharp = sharpened(blurred)
    assert np.square(sharp - truth).mean() < 0.6 * np.square(blurred - truth).mean()
    assert sharp.min() >= blurred.min()
    assert sharp.max() <= blurred.max()
    assert np.array_equal(sharpened(truth), truth)  # steeper than that they cannot be


def test_sharper_coarse_volumes_spare_passes(monkeypatch):
    truth, grid = balls(voxels=36)
    scan = voxel_scan(truth, grid, views=24, pixels=48, geometry=circular(48, 48, 24, 0.5), seed=1)
    monkeypatch.setattr("recon.voxel.iterative.one_step.FEW_VIEWS", 1)
    method = OneStep(levels=((2, 8), (1, 2)))
    sharp = method.reconstruct_counts(scan, grid)
    monkeypatch.setattr("recon.voxel.iterative.one_step.sharpened", lambda volumes: volumes)
    blurred = method.reconstruct_counts(scan, grid)
    assert np.mean(decibels(sharp, truth)) > np.mean(decibels(blurred, truth)) + 0.3


def test_longer_steps_at_edges_spare_passes(monkeypatch):
    truth, grid = balls(voxels=36)
    scan = voxel_scan(truth, grid, views=24, pixels=48, geometry=circular(48, 48, 24, 0.5), seed=1)
    monkeypatch.setattr("recon.voxel.iterative.one_step.FEW_VIEWS", 1)
    method = OneStep(levels=((2, 8), (1, 8)))
    _, uneven = deviances(method, scan, grid)
    monkeypatch.setattr("recon.voxel.iterative.one_step.LEAST_CHANGE", 1.0)
    _, even = deviances(method, scan, grid)
    assert uneven[11] - even[-1] < 0.6 * (even[11] - even[-1])  # after four passes at full resolution
    assert uneven[-1] == pytest.approx(even[-1], rel=0.03)


@pytest.mark.parametrize("size", [1, 3])
def test_values_in_metal_become_means_of_what_is_interpolated_between_them(size):
    """Means by 40 points along each axis."""
    rng = np.random.default_rng(size)
    volumes = rng.uniform(0.01, 0.02, (2, 12, 12, 12))
    volumes[:, 5 : 5 + size, 6, 4 : 4 + size] = rng.uniform(1.4, 1.6)
    found = means_in_metal(volumes.astype(np.float32))
    within = np.arange(-0.5, 0.5, 1 / 40) + 1 / 80
    for z, y, x in ((5, 6, 4), (5, 5, 4), (4, 7, 3), (6, 6, 4)):
        points = np.meshgrid(z + within, y + within, x + within, indexing="ij")
        means = [map_coordinates(v, points, order=1).mean() for v in volumes]
        np.testing.assert_allclose(found[:, z, y, x], means, rtol=3e-3)
    np.testing.assert_array_equal(found[:, :, :, 8:], volumes.astype(np.float32)[:, :, :, 8:])


def test_volumes_without_metal_are_means_as_they_are():
    volumes = np.random.default_rng(0).uniform(0.01, 0.025, (2, 8, 8, 8)).astype(np.float32)
    assert means_in_metal(volumes) is volumes


@pytest.mark.parametrize("wrong", [{"levels": ()}, {"levels": ((0, 3),)}, {"subsets": 0}, {"strength": -1.0}])
def test_settings_that_cannot_be_are_refused(wrong):
    with pytest.raises(InputError, match=f"one-step .*{next(iter(wrong))}"):
        OneStep(**wrong)


def test_total_variation_has_little_say_where_hardly_a_photon_arrives(monkeypatch):
    """An even one would exchange the bases of what is opaque to all channels but one."""
    truth, grid = balls(voxels=24, bases=2)
    truth[0, 8:16, 8:16, 8:16], truth[1, 8:16, 8:16, 8:16] = 2.0, 0.5
    scan = voxel_scan(truth, grid, photons=2e4, geometry=circular(32, 32, 24, 0.75), seed=1)
    inside = np.s_[0, 10:14, 10:14, 10:14]
    assert OneStep().reconstruct_counts(scan, grid)[inside].mean() > 0.8 * 2.0
    monkeypatch.setattr(
        "recon.voxel.iterative.one_step._statistical_weights", lambda curvatures, density: np.ones_like(density)
    )
    assert OneStep().reconstruct_counts(scan, grid)[inside].mean() < 0.7 * 2.0
