"""A beam that differs over the panel: decomposition, likelihood and curvature know what each pixel got."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from support.gaussian_scenes import circular, small_model, spectral_model

from recon.data.measurements import Measurements
from recon.gaussians.fisher import ray_information
from recon.gaussians.likelihood import likelihood, likelihood_and_gradients
from recon.gaussians.model import PARTS
from recon.ops.decompose import decompose
from spectra.transmission import Transmission

GEOMETRY = circular(12, 14, views=4)


def with_filter(model):
    """The same model with the column of a filter that hardens the beam."""
    energy = np.linspace(25, 115, len(model.weights))
    return Transmission(np.vstack([model.columns, (50 / energy) ** 2.5]), model.weights, model.starts)


@pytest.fixture(scope="module")
def truth():
    return small_model(1, count=20)


@pytest.fixture(scope="module")
def scan(truth):
    """Exact counts behind a filter that is thicker towards the edges, and of negative length in the middle."""
    profile = np.linspace(-1, 1, 14)[None, None] ** 2 * np.linspace(0.8, 1.2, 12)[None, :, None] - 0.2
    gains = np.full((4, 12, 14), 1.3, np.float32)
    empty = np.zeros((4, 4, 12, 14), np.float32)
    scan = Measurements(
        empty, gains, np.ones(empty.shape[:2]), GEOMETRY, with_filter(spectral_model(3)), truth.basis_names, profile
    )
    lengths = scan.with_profile(np.moveaxis(truth.line_integrals(GEOMETRY).numpy().astype(float), 1, -1))
    return replace(scan, counts=(1.3 * np.moveaxis(scan.transmission.expected(lengths), -1, 1)).astype(np.float32))


def test_the_true_model_explains_the_counts_with_the_profile_only(truth, scan):
    assert likelihood(truth, scan, 0.0).deviance < 5e-3  # rounding of float32; noise alone would give 1
    plain = replace(scan, transmission=spectral_model(3), profile=None)
    flat_only = replace(plain, gains=(scan.gains * scan.open_beam / plain.open_beam).astype(np.float32))
    assert likelihood(truth, flat_only, 0.0).deviance > 1


def test_the_gradient_of_the_deviance_is_that_of_its_differences(truth, scan):
    coefficients = truth.coefficients.double() * 1.2
    direction = torch.from_numpy(np.random.default_rng(1).normal(size=coefficients.shape)) * coefficients

    def at(step):
        moved = replace(truth, coefficients=(coefficients + step * direction).float()).detached()
        for part in PARTS:
            getattr(moved, part).requires_grad_()
        return moved, likelihood_and_gradients(moved, scan, np.arange(len(scan)), 0.0).deviance

    model, _ = at(0.0)
    assert model.coefficients.grad is not None
    slope = (model.coefficients.grad * direction).sum().item()
    assert slope == pytest.approx((at(0.02)[1] - at(-0.02)[1]) / 0.04, rel=1e-2)


def test_rays_are_as_informative_as_the_transmission_says(truth, scan):
    images = truth.line_integrals(GEOMETRY).numpy().astype(float)
    found = ray_information(scan, images, 0.01)
    lengths = scan.with_profile(np.moveaxis(images, 1, -1))
    scaled = replace(scan.transmission, weights=1.3 * scan.transmission.weights)
    np.testing.assert_allclose(found, scaled.fisher(lengths, 0.01)[..., :3, :3], rtol=1e-5)


def test_known_lengths_do_not_change_the_line_integrals(scan):
    rng = np.random.default_rng(3)
    lengths, known = rng.uniform(0, [1.0, 1.5, 0.5], (40, 3)), rng.uniform(-0.3, 1.0, (40, 1))
    model = replace(scan.transmission, weights=scan.transmission.weights * 1e4)
    counts = model.expected(np.hstack([lengths, known]))
    found, fisher = decompose(counts, np.ones((40, 4)), model, iterations=60, tolerance=1e-9, known=known)
    np.testing.assert_allclose(found, lengths, atol=1e-5)
    np.testing.assert_allclose(fisher, model.fisher(np.hstack([lengths, known]))[:, :3, :3], rtol=1e-3)


def test_few_nodes_serve_all_pixels(truth, scan):
    few, error = scan.compressed(1e-4)
    assert len(few.transmission.weights) < len(scan.transmission.weights)
    lengths = scan.with_profile(np.moveaxis(truth.line_integrals(GEOMETRY).numpy().astype(float), 1, -1))
    change = np.log(few.transmission.expected(lengths) / scan.transmission.expected(lengths))
    assert np.abs(change).max() < 2 * max(error, 1e-9)
