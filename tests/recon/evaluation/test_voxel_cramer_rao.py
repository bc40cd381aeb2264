"""The bound of the noise in averages over voxels, against dense matrices."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.voxel_scenes import balls, voxel_scan

from recon.evaluation.voxel_cramer_rao import VoxelInformation, least_variances
from recon.voxel.iterative.likelihood import forward


def tiny(bases=2):
    truth, grid = balls(voxels=4, bases=bases)
    return truth, grid, voxel_scan(truth, grid, views=7, pixels=9)


def dense_information(truth, grid, scan):
    """The whole matrix, from one projection per voxel, in float64."""
    bases, voxels = len(truth), truth[0].size
    unit = np.eye(voxels, dtype=np.float32).reshape(voxels, *truth[0].shape)
    system = forward(unit, scan.geometry, grid).reshape(voxels, -1).astype(float)
    lengths = np.moveaxis(forward(truth, scan.geometry, grid), 0, -1).reshape(-1, bases).astype(float)
    rays = scan.transmission.fisher(lengths)
    return np.einsum("ir,jr,rmn->minj", system, system, rays).reshape(bases * voxels, -1)


@pytest.mark.parametrize("bases", [1, 2, 3])
def test_information_times_a_volume_is_the_dense_product(bases):
    truth, grid, scan = tiny(bases)
    vector = np.random.default_rng(1).normal(size=(2, *truth.shape))
    found = VoxelInformation.of(scan, truth, grid).times(vector).reshape(2, -1)
    np.testing.assert_allclose(found, vector.reshape(2, -1) @ dense_information(truth, grid, scan), rtol=2e-4, atol=0.1)


@settings(max_examples=8)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 3))
@pytest.mark.slow
def test_the_bound_is_that_of_the_dense_inverse(seed, count):
    truth, grid, scan = tiny()
    weights = np.random.default_rng(seed).uniform(size=(count, *grid.shape))
    inverse = np.linalg.inv(dense_information(truth, grid, scan)).reshape(2, 64, 2, 64)
    flat = weights.reshape(count, -1)
    expected = np.stack([np.einsum("ki,ij,kj->k", flat, inverse[m, :, m], flat) for m in range(2)], axis=1)
    found = least_variances(VoxelInformation.of(scan, truth, grid), weights, iterations=300, converged=0)
    np.testing.assert_allclose(found, expected, rtol=2e-3)


def test_the_bound_only_grows_with_iterations_and_never_beyond_the_inverse():
    truth, grid, scan = tiny()
    information = VoxelInformation.of(scan, truth, grid)
    weights = np.zeros((1, *grid.shape))
    weights[0, 1:3, 1:3, 1:3] = 1 / 8
    found = np.stack([least_variances(information, weights, n, 0) for n in (1, 2, 4, 8, 16, 32)])
    assert (np.diff(found, axis=0) > -1e-6 * found[-1]).all()
    covariance = np.linalg.inv(dense_information(truth, grid, scan)).reshape(2, 64, 2, 64)
    limit = [weights.ravel() @ covariance[m, :, m] @ weights.ravel() for m in range(2)]
    assert (found <= 1.002 * np.array(limit)).all()


def test_twice_the_photons_halve_the_variance():
    truth, grid, scan = tiny()
    more = voxel_scan(truth, grid, views=7, pixels=9, photons=2e5)
    weights = np.full((1, *grid.shape), 1 / 64)
    once, twice = (least_variances(VoxelInformation.of(s, truth, grid), weights, 100, 0) for s in (scan, more))
    np.testing.assert_allclose(twice, once / 2, rtol=1e-4)


def test_voxels_that_no_ray_meets_leave_the_bound_of_others_as_it_is():
    """A grid that reaches far beyond the beam on one side; weights where the beam is."""
    truth, grid, scan = tiny()
    wide = type(grid)((12, 4, 4), grid.spacing, (grid.origin[0] - 4 * grid.spacing[0], *grid.origin[1:]))
    padded = np.zeros((2, *wide.shape), np.float32)
    padded[:, 4:8] = truth
    information = VoxelInformation.of(scan, padded, wide)
    unseen = ~(information.times(np.ones((1, *padded.shape)))[0, 0] > 0)
    assert unseen.any()
    weights = np.zeros((1, *wide.shape))
    weights[0, 5:7, 1:3, 1:3] = 1 / 8
    found = least_variances(information, weights, 100, 0)
    assert np.isfinite(found).all()
    assert (found > 0).all()
