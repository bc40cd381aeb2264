from dataclasses import replace

import numpy as np
import pytest
import torch
from support.gaussian_scenes import circular, small_model, small_scan, spectral_model
from support.tolerances import TOLERANCES

from recon.gaussians.fisher import coefficient_curvature, ray_information, ray_information_on_device
from recon.ops.deviance import deviance
from recon.ops.rasterize import rasterize
from spectra.ops.transmit import reference

GEOMETRY = circular(6, 7, views=6)


def a_priori_images(gaussians, geometry):
    """Line integrals of every Gaussian with coefficient 1, (gaussian, view, row, column), from the kernel."""
    parts = (gaussians.centres, gaussians.log_scales, gaussians.quaternions, torch.eye(len(gaussians)))
    frames = torch.from_numpy(geometry.ray_frames())
    images = rasterize(*parts, frames, geometry.panel.rows, geometry.panel.columns)
    return images.movedim(1, 0).double().flatten(1)


def true_hessian(gaussians, scan, dispersion):
    """Second derivatives of half the deviance in all coefficients, by automatic differentiation in float64."""
    images, model = a_priori_images(gaussians, scan.geometry), scan.transmission
    counts = torch.from_numpy(scan.counts).double().movedim(1, -1).flatten(0, 2)
    columns, weights = torch.from_numpy(model.columns), torch.from_numpy(model.weights)

    def half_deviance(flat):
        lengths = images.T @ flat.reshape(len(gaussians), -1)
        expected = reference.transmit(lengths, columns, weights, model.starts.tolist())
        return deviance(counts, expected, dispersion).sum() / 2

    return torch.autograd.functional.hessian(half_deviance, gaussians.coefficients.double().flatten()).numpy()


def as_matrix(blocks):
    n, m, _ = blocks.shape
    out = np.zeros((n, m, n, m))
    out[np.arange(n), :, np.arange(n), :] = blocks
    return out.reshape(n * m, n * m)


@pytest.mark.parametrize("dispersion", [0.0, 0.01])
@pytest.mark.parametrize("bases", [1, 2, 3])
def test_curvature_majorises_the_true_hessian(bases, dispersion):
    gaussians, model = small_model(1, count=6, bases=bases, spread=3.0), spectral_model(bases)
    scan = small_scan(gaussians, GEOMETRY, model)
    hessian = true_hessian(gaussians, scan, dispersion)
    blocks = as_matrix(coefficient_curvature(gaussians, scan, dispersion).double().numpy())
    lowest = np.linalg.eigvalsh(blocks - hessian).min()
    assert lowest > -TOLERANCES["curvature"] * np.linalg.eigvalsh(hessian).max()


def test_a_lone_gaussian_has_the_curvature_of_its_hessian():
    gaussians = small_model(2, count=1, bases=2, spread=1.0)
    scan = small_scan(gaussians, GEOMETRY, spectral_model(2))
    block = coefficient_curvature(gaussians, scan, 0.0)[0].numpy()
    hessian = true_hessian(gaussians, scan, 0.0)
    np.testing.assert_allclose(block, hessian, rtol=0, atol=1e-3 * abs(hessian).max())


def test_natural_steps_do_not_depend_on_the_basis():
    """With columns T^T B and coefficients T^-1 b nothing that can be measured changes; the blocks become T^T K T."""
    gaussians, model = small_model(3, count=5, bases=2, spread=3.0), spectral_model(2)
    turn = np.array([[1.0, 0.4], [-0.2, 1.5]])
    turned = replace(gaussians, coefficients=gaussians.coefficients @ torch.from_numpy(np.linalg.inv(turn).T).float())
    scan = small_scan(gaussians, GEOMETRY, model)
    other = replace(scan, transmission=replace(model, columns=turn.T @ model.columns))
    blocks = coefficient_curvature(gaussians, scan, 0.01).double().numpy()
    expected = np.einsum("mi,gmn,nj->gij", turn, blocks, turn)
    found = coefficient_curvature(turned, other, 0.01).double().numpy()
    np.testing.assert_allclose(found, expected, atol=TOLERANCES["curvature"] * abs(expected).max())


def test_views_at_once_make_no_difference(monkeypatch):
    gaussians, model = small_model(4, count=5, bases=2), spectral_model(2)
    scan = small_scan(gaussians, GEOMETRY, model)
    together = coefficient_curvature(gaussians, scan, 0.01)
    monkeypatch.setattr("recon.gaussians.fisher.VIEWS_AT_ONCE", 1)
    assert torch.allclose(coefficient_curvature(gaussians, scan, 0.01), together, rtol=1e-5)


def test_information_of_rays_follows_gain_and_exposure():
    gaussians, model = small_model(5, count=5, bases=3), spectral_model(3)
    scan = small_scan(gaussians, GEOMETRY, model)
    rng = np.random.default_rng(1)
    gains, exposure = rng.uniform(0.5, 2, scan.gains.shape), rng.uniform(0.5, 2, scan.counts.shape[:2])
    lengths = rng.uniform(0, 1, (len(scan), 3, 6, 7))
    found = ray_information(replace(scan, gains=gains, exposure=exposure), lengths, 0.02)
    for view, row, column in [(0, 0, 0), (5, 2, 6), (3, 5, 1)]:
        expected, jacobian = model.expected_and_jacobian(lengths[view, :, row, column])
        scale = gains[:, row, column] * exposure[view]
        y = expected * scale
        j = jacobian * scale[:, None]
        right = j.T @ np.diag(1 / (y + (0.02 * y) ** 2)) @ j
        np.testing.assert_allclose(found[view, row, column], right, rtol=1e-10)


@pytest.mark.parametrize("profile", [False, True])
def test_information_on_a_device_is_the_same(profile):
    scan = small_scan(small_model(0), GEOMETRY, spectral_model())
    if profile:
        model = replace(
            scan.transmission, columns=np.vstack([scan.transmission.columns, scan.transmission.columns[:1]])
        )
        scan = replace(scan, transmission=model, profile=np.full((1, *scan.counts.shape[2:]), 0.2, np.float32))
    random = np.random.default_rng(0)
    scan = replace(scan, statistical_weights=random.uniform(0, 1, scan.counts.shape).astype(np.float32))
    lengths = random.uniform(0, 2, (len(scan), len(scan.basis_names), *scan.counts.shape[2:]))
    found = ray_information_on_device(scan, torch.from_numpy(lengths), 0.02)
    np.testing.assert_allclose(found.numpy(), ray_information(scan, lengths, 0.02), rtol=1e-9)
