"""Counts of pixels with an edge inside, corrected to what the mean line integral would have given."""

from dataclasses import replace

import numpy as np
import pytest
from gaussian_scenes import NAMES, circular, one_gaussian, small_model, spectral_model

from recon.gaussians import Gaussians
from recon.measurements import Measurements
from recon.partial_volume import without_partial_volume
from spectra.transmission import Transmission

GEOMETRY, FINER = circular(12, 14, views=2), 16


def filtered(model):
    """The same model with the column of a filter."""
    energy = np.linspace(25, 115, len(model.weights))
    return Transmission(np.vstack([model.columns, (50 / energy) ** 2.5]), model.weights, model.starts)


def fine_lengths(model):
    """Line integrals of many rays in each pixel: (view, row, ray, column, ray, basis)."""
    lengths = model.line_integrals(GEOMETRY.subdivided(FINER)).numpy().astype(float)
    return np.moveaxis(lengths, 1, -1).reshape(2, 12, FINER, 14, FINER, 3)


def scan_of(model, profile=None, gain=1.3):
    """Counts as a detector sums them: means of the intensities of many rays in each pixel."""
    transmission = spectral_model(3) if profile is None else filtered(spectral_model(3))
    lengths = fine_lengths(model)
    if profile is not None:
        known = np.moveaxis(profile, 0, -1)[:, None, :, None]
        lengths = np.concatenate([lengths, np.broadcast_to(known, (*lengths.shape[:-1], len(profile)))], axis=-1)
    counts = np.moveaxis(transmission.expected(lengths).mean(axis=(2, 4)), -1, 1) * gain
    gains = np.full((4, 12, 14), gain, np.float32)
    exposure = np.ones((2, 4))
    return Measurements(counts.astype(np.float32), gains, exposure, GEOMETRY, transmission, NAMES, profile)


def of_mean_line_integrals(scan, model):
    """Counts that one ray per pixel would give, with the means of the line integrals."""
    lengths = scan.with_profile(fine_lengths(model).mean(axis=(2, 4)))
    return np.moveaxis(scan.transmission.expected(lengths), -1, 1) * scan.gains


@pytest.mark.parametrize("with_profile", [False, True])
def test_counts_become_those_of_one_ray_per_pixel(with_profile):
    dense = Gaussians(*(part.float() for part in one_gaussian([0.3, -0.2, 0.1], [0.5, 0.4, 2.5], 3)), NAMES)
    dense = replace(dense, coefficients=dense.coefficients * 0.2)
    profile = np.linspace(-0.3, 0.7, 12 * 14).reshape(1, 12, 14) if with_profile else None
    scan = scan_of(dense, profile)
    wanted = of_mean_line_integrals(scan, dense)
    off, left = (abs(np.log(s.counts / wanted)).max() for s in (scan, without_partial_volume(scan, dense, rays=8)))
    assert off > 0.05
    assert left < 0.05 * off


def test_a_model_that_is_nearly_right_takes_most_of_it_away():
    truth = small_model(3, count=40, height=0.1)
    scan = scan_of(truth)
    nearly = replace(truth, log_scales=truth.log_scales + 0.05, coefficients=truth.coefficients * 0.9)
    wanted = of_mean_line_integrals(scan, truth)
    off, left = (np.log(s.counts / wanted) for s in (scan, without_partial_volume(scan, nearly)))
    assert np.sqrt((left**2).mean()) < 0.35 * np.sqrt((off**2).mean())
    assert off.min() > -1e-5  # intensities of means are the least there can be


def test_air_and_blind_pixels_stay_as_they_are():
    far = Gaussians(*(part.float() for part in one_gaussian([0.0, 0.0, 40.0], 0.1, 3)), NAMES)
    scan = scan_of(far)
    scan.counts[:, :, 3, 4], scan.gains[:, 3, 4] = 0, 0
    np.testing.assert_allclose(without_partial_volume(scan, far).counts, scan.counts, rtol=1e-6)


def test_rays_that_nothing_passes_give_finite_counts():
    wall = Gaussians(*(part.float() for part in one_gaussian([0.0, 0.0, 0.0], 1.0, 3)), NAMES)
    wall = replace(wall, coefficients=wall.coefficients * 1e5)
    corrected = without_partial_volume(scan_of(wall), wall)
    assert np.isfinite(corrected.counts).all()
