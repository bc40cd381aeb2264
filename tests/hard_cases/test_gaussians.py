"""Gaussians, rays and scans at the limits: results stay finite and do what the documentation says."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from support.gaussian_scenes import (
    GEOMETRIES,
    PIXEL,
    circular,
    frames_of,
    one_gaussian,
    random_gaussians,
    small_model,
    small_scan,
    spectral_model,
)
from support.tolerances import TOLERANCES

from phantomgen.geometry.voxel_grid import Grid
from recon.gaussians.fisher import coefficient_curvature
from recon.gaussians.initial.initialize import initialize
from recon.gaussians.optimize import fit
from recon.gaussians.recipe import Recipe, Stage
from recon.ops.decompose import decompose
from recon.ops.rasterize import Projector, rasterize, reference
from recon.ops.voxelize import voxelize
from spectra.transmission import Transmission

PARTS = ("centres", "log_scales", "quaternions", "coefficients")
UNCUT = Projector(cutoff=5.0)  # standard deviations; next to nothing lies beyond
SHORT = Recipe(stages=(Stage(1.0, 3.0),))


def image_and_gradients(parts, geometry, projector=None):
    """Images by the kernels, or by the reference where no projector is given, and gradients for random cotangents."""
    leaves = [part.clone().requires_grad_() for part in parts]
    view = (*leaves, frames_of(geometry), geometry.panel.rows, geometry.panel.columns)
    image = reference.rasterize(*view, 1.0) if projector is None else rasterize(*view, projector)
    cotangent = torch.from_numpy(np.random.default_rng(0).normal(size=image.shape)).to(image)
    return image.detach(), torch.autograd.grad(image, leaves, cotangent)


def needles(count=30, thin=0.02, aspect=1e3):
    """Needles of aspect `aspect` in all directions, `thin` pixels wide."""
    centres, scales, turns, values = random_gaussians(1, count)
    scales[:, 0], scales[:, 1:] = np.log(thin * aspect * PIXEL), np.log(thin * PIXEL)
    return centres, scales, turns, values


@pytest.mark.parametrize("where", GEOMETRIES)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_needles_a_thousand_times_longer_than_wide(where, dtype):
    parts, geometry = needles(), GEOMETRIES[where]
    truth, gradients = image_and_gradients(parts, geometry)
    image, kernel_gradients = image_and_gradients([p.to(dtype) for p in parts], geometry, UNCUT)
    assert (image - truth).abs().max() < 3e-4 * truth.max()
    for gradient, right in zip(kernel_gradients, gradients, strict=True):
        assert torch.isfinite(gradient).all()
        assert (gradient - right).norm() < 0.01 * right.norm()


def test_flat_discs_a_thousand_times_wider_than_thick():
    centres, scales, turns, values = needles()
    scales = scales.flip(1)
    scales[:, :2] = np.log(20 * PIXEL)
    image, gradients = image_and_gradients((centres, scales, turns, values), GEOMETRIES["tilted"], Projector())
    assert torch.isfinite(image).all()
    assert all(torch.isfinite(gradient).all() for gradient in gradients)


def test_a_needle_along_a_ray():
    """Seen from its end: a line integral a thousand times that of a ball of its width, in a narrow footprint."""
    geometry = circular(13, 17, views=1)
    source = geometry.ray_frames()[0, 0]
    centres, _, turns, values = one_gaussian([0.0, 0.0, 0.0], 1.0)
    towards = source / np.linalg.norm(source)
    turns[0] = torch.tensor([np.cos(np.arctan2(towards[1], towards[0]) / 2), 0, 0, np.sin(0.1)])
    scales = torch.tensor([[10.0, 0.01, 0.01]]).double().log()
    image, gradients = image_and_gradients((centres, scales, turns, values), geometry, Projector(footprint=0.0))
    assert image.max() == pytest.approx(np.sqrt(2 * np.pi) * 10, rel=1e-4)
    assert all(torch.isfinite(gradient).all() for gradient in gradients)


@pytest.mark.parametrize("sigma", [1e-6, 0.05, 1e3])
def test_a_gaussian_far_smaller_than_a_pixel_and_one_far_larger_than_the_panel(sigma):
    parts, geometry = one_gaussian([0.31, -0.17, 0.23], sigma * PIXEL), circular()
    truth, gradients = image_and_gradients(parts, geometry)
    image, kernel_gradients = image_and_gradients(parts, geometry, UNCUT)
    assert (image - truth).abs().max() <= TOLERANCES["kernel_value"] * truth.max()
    for gradient, right in zip(kernel_gradients, gradients, strict=True):
        assert (gradient - right).norm() <= 1e-3 * gradients[0].norm() + TOLERANCES["kernel_gradient"] * right.norm()
    volume = voxelize(*parts, Grid.cube(16, 16.0))
    assert np.isfinite(volume).all()
    if sigma < 1:
        mass = (2 * np.pi) ** 1.5 * (sigma * PIXEL) ** 3
        assert volume.sum() == pytest.approx(mass, rel=TOLERANCES["narrow_voxel_mass"])


def test_a_gaussian_around_the_source():
    """Rays begin inside of it: what lies behind the source does not count."""
    parts, geometry = one_gaussian([55.0, 0.0, 0.0], 10.0), circular(views=5)
    image, gradients = image_and_gradients(parts, geometry, Projector())
    assert torch.isfinite(image).all()
    assert all(torch.isfinite(gradient).all() for gradient in gradients)


def test_gaussians_in_the_plane_of_the_source():
    """Their projection runs to infinity."""
    geometry = circular(views=1)
    source, _, column_step, _ = geometry.ray_frames()[0]
    for shift in (0.0, 1e-12, 1e-3):
        centre = source + 3 * column_step - shift * source
        image, gradients = image_and_gradients(one_gaussian(list(centre), 1.0), geometry, Projector())
        assert torch.isfinite(image).all()
        assert all(torch.isfinite(gradient).all() for gradient in gradients)


@pytest.mark.parametrize("views", [1, 2])
def test_fitting_one_gaussian_to_one_view(views):
    truth = small_model(1, count=1, spread=1.0)
    scan = small_scan(truth, circular(8, 8, views=views), spectral_model(3))
    start = replace(truth, coefficients=truth.coefficients * 0.5)
    fitted = fit(start, scan, PIXEL, SHORT)
    assert len(fitted) == 1
    assert all(torch.isfinite(getattr(fitted, name)).all() for name in PARTS)


def test_fitting_gaussians_that_no_ray_meets():
    """They stay where they are, with what they carry; nothing becomes infinite."""
    truth = small_model(2, count=4, spread=1.0)
    scan = small_scan(truth, circular(8, 8, views=3), spectral_model(3))
    centres = truth.centres.clone()
    centres[0] = torch.tensor([0.0, 0.0, 50.0])
    start = replace(truth, centres=centres)
    fitted = fit(start, scan, PIXEL, SHORT)
    assert torch.equal(fitted.centres[0], start.centres[0])
    assert torch.equal(fitted.coefficients[0], start.coefficients[0])
    alone = replace(start, **{name: getattr(start, name)[:1] for name in PARTS})
    assert all(torch.isfinite(getattr(fit(alone, scan, PIXEL, SHORT), name)).all() for name in PARTS)


def test_fitting_a_channel_without_counts_and_a_scan_without_any():
    truth = small_model(3, count=20)
    scan = small_scan(truth, circular(8, 8, views=3), spectral_model(3), seed=1)
    for channels in (slice(0, 1), slice(None)):
        counts = scan.counts.copy()
        counts[:, channels] = 0
        fitted = fit(truth, replace(scan, counts=counts), PIXEL, SHORT)
        assert all(torch.isfinite(getattr(fitted, name)).all() for name in PARTS)
        assert (fitted.coefficients >= 0).all()


def test_fitting_with_one_photon_per_pixel():
    truth = small_model(4, count=20)
    scan = small_scan(truth, circular(8, 8, views=6), spectral_model(3, photons=1.0), seed=2)
    fitted = fit(truth, scan, PIXEL, SHORT)
    assert all(torch.isfinite(getattr(fitted, name)).all() for name in PARTS)
    assert (fitted.coefficients >= 0).all()


def test_fitting_an_opaque_object():
    """So much material that no photon is expected behind it, although photons were counted."""
    truth = small_model(5, count=20)
    scan = small_scan(truth, circular(8, 8, views=3), spectral_model(3))
    opaque = replace(truth, coefficients=truth.coefficients * 1e4)
    fitted = fit(opaque, scan, PIXEL, SHORT)
    assert all(torch.isfinite(getattr(fitted, name)).all() for name in PARTS)
    assert torch.isfinite(coefficient_curvature(opaque, scan, 0.01)).all()


@pytest.mark.parametrize("shape", [(1, 1, 1), (3, 1, 2)])
def test_volumes_of_one_voxel(shape):
    grid = Grid(shape, (2.0, 2.0, 2.0), (0.0, 0.0, 0.0))
    gaussians = initialize(np.full((1, *shape), 0.02, np.float32), grid, np.eye(1), 2.0, ("compton",), 0)
    volume = gaussians.volume(grid)
    assert volume.shape == (1, *shape)
    assert np.isfinite(volume).all()
    assert (volume > 0).all()


def test_decomposing_rays_without_counts():
    """A weak prior at zero length decides where the counts cannot; every result is finite."""
    model = spectral_model(3)
    for counts in (np.zeros((1, 4)), np.array([[0.0, 10, 200, 300]]), np.array([[1.0, 0, 0, 0]])):
        lengths, fisher = decompose(counts, np.ones((1, 4)), model)
        assert np.isfinite(lengths).all()
        assert np.isfinite(fisher).all()
    # without open beam there is nothing to learn, and the prior says zero
    lengths, fisher = decompose(np.zeros((1, 4)), np.zeros((1, 4)), model)
    assert abs(lengths).max() < 1e-3
    assert not fisher.any()


def test_decomposing_one_photon_per_pixel():
    model = spectral_model(2, photons=1.0)
    counts = np.random.default_rng(3).poisson(model.open_beam, (500, 4)).astype(float)
    lengths, fisher = decompose(counts, np.ones_like(counts), model)
    assert np.isfinite(lengths).all()
    assert np.isfinite(fisher).all()
    assert abs(np.median(lengths, axis=0)).max() < 20


@pytest.mark.parametrize("difference", [1e-1, 1e-2, 1e-5, 0.0])
def test_decomposing_into_bases_that_are_almost_the_same(difference):
    """Right down to a tenth of difference; below, results are finite, and of identical bases the sum is right."""
    model = spectral_model(1, photons=1e6)
    energy = np.linspace(0, 1, model.columns.shape[1])
    columns = np.concatenate([model.columns, model.columns * (1 + difference * energy)])
    twins = Transmission(columns, model.weights, model.starts)
    lengths, fisher = decompose(twins.expected(np.array([[0.4, 0.6]])), np.ones((1, 4)), twins)
    assert np.isfinite(lengths).all()
    assert np.isfinite(fisher).all()
    if difference not in (1e-2, 1e-5):
        assert lengths.sum() == pytest.approx(1.0, abs=0.01)
    if difference == 1e-1:
        np.testing.assert_allclose(lengths, [[0.4, 0.6]], atol=0.01)


def test_fitting_bases_that_are_almost_the_same():
    truth, model = small_model(6, count=20, bases=2), spectral_model(2)
    twins = replace(model, columns=np.stack([model.columns[0], model.columns[0] * 1.0001]))
    scan = small_scan(truth, circular(8, 8, views=3), twins, seed=4)
    fitted = fit(truth, scan, PIXEL, SHORT)
    assert all(torch.isfinite(getattr(fitted, name)).all() for name in PARTS)
