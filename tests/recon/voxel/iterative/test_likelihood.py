import numpy as np
import pytest
from support.voxel_scenes import balls, voxel_scan

from recon.ops.nonnegative_newton import as_matrices
from recon.voxel.iterative.likelihood import _sums, _sums_on_device, curvature, deviance_and_gradient, forward


def some_scan(bases=2, seed=1):
    truth, grid = balls(voxels=6, bases=bases)
    return truth, grid, voxel_scan(truth, grid, views=5, pixels=8, seed=seed)


@pytest.mark.parametrize("dispersion", [0.0, 0.05])
def test_gradient_agrees_with_differences_of_the_deviance(dispersion):
    truth, grid, scan = some_scan()
    rng = np.random.default_rng(2)
    volumes = (truth * rng.uniform(0.5, 1.5, truth.shape)).astype(np.float32)
    _, gradient = deviance_and_gradient(volumes, scan, grid, dispersion)
    for seed in range(3):
        way = np.random.default_rng(seed).normal(size=truth.shape).astype(np.float32)
        step = np.float32(2e-4)
        ends = [deviance_and_gradient(volumes + s * step * way, scan, grid, dispersion)[0] / 2 for s in (1, -1)]
        slope = (ends[0] - ends[1]) / (2 * float(step))
        assert slope == pytest.approx(np.vdot(gradient.astype(float), way), rel=2e-3)


def test_views_at_once_make_no_difference(monkeypatch):
    truth, grid, scan = some_scan()
    together = deviance_and_gradient(truth, scan, grid, 0.01)
    monkeypatch.setattr("recon.voxel.iterative.likelihood.VIEWS_AT_ONCE", 2)
    apart = deviance_and_gradient(truth, scan, grid, 0.01)
    assert apart[0] == pytest.approx(together[0], rel=1e-12)
    np.testing.assert_allclose(apart[1], together[1], atol=1e-4 * np.abs(together[1]).max())


def true_information(truth, grid, scan):
    """The whole Fisher matrix of all coefficients, and the covariance of a voxel's gradient, in float64."""
    bases, voxels = len(truth), truth[0].size
    unit = np.eye(voxels, dtype=np.float32).reshape(voxels, *truth[0].shape)
    system = forward(unit, scan.geometry, grid).reshape(voxels, -1).astype(float)
    lengths = np.moveaxis(forward(truth, scan.geometry, grid), 0, -1).reshape(-1, bases).astype(float)
    rays = scan.transmission.fisher(lengths, 0.01)
    whole = np.einsum("ir,jr,rmn->imjn", system, system, rays).reshape(voxels * bases, -1)
    return whole, np.einsum("ir,rmn->imn", system**2, rays)


@pytest.mark.parametrize("uneven", [False, True])
@pytest.mark.parametrize("bases", [1, 2])
def test_curvature_majorises_the_fisher_matrix_for_any_changes(bases, uneven):
    truth, grid, scan = some_scan(bases, seed=None)
    whole, _ = true_information(truth, grid, scan)
    changes = np.random.default_rng(0).uniform(0.1, 3, grid.shape).astype(np.float32) if uneven else None
    blocks = as_matrices(curvature(truth, scan, grid, 0.01, changes)[0]).reshape(-1, bases, bases)
    separable = np.zeros_like(whole)
    for i, block in enumerate(blocks):
        separable[i * bases : (i + 1) * bases, i * bases : (i + 1) * bases] = block
    assert np.linalg.eigvalsh(separable - whole).min() > -1e-5 * np.linalg.eigvalsh(whole).max()


def test_the_covariance_of_the_gradient_is_that_of_its_formula():
    truth, grid, scan = some_scan(bases=2, seed=None)
    _, covariances = true_information(truth, grid, scan)
    weights = truth.sum(axis=0).ravel()
    right = np.average(covariances, axis=0, weights=weights)
    found = curvature(truth, scan, grid, 0.01)[1]
    assert np.abs(found - right).max() < 0.15 * np.abs(right).max()


def test_without_any_material_all_voxels_count_alike():
    truth, grid, scan = some_scan(bases=2, seed=None)
    right = true_information(0 * truth, grid, scan)[1].mean(axis=0)
    assert np.abs(curvature(0 * truth, scan, grid, 0.01)[1] - right).max() < 0.15 * np.abs(right).max()


@pytest.mark.parametrize("start", [0, 1])
def test_sums_of_tensors_are_the_same(start):
    truth, grid = balls()
    scan, random = voxel_scan(truth, grid), np.random.default_rng(0)
    probes = random.uniform(0, 1, (3, *grid.shape)).astype(np.float32)
    arguments = (start * truth.astype(np.float32), probes, scan, grid, 0.01)
    for found, wanted in zip(_sums_on_device(*arguments, "cpu"), _sums(*arguments), strict=True):
        np.testing.assert_allclose(found, wanted, rtol=1e-4, atol=1e-5 * np.abs(wanted).max())
