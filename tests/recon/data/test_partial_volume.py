"""Counts of pixels that something varies in become those of mean line integrals; rays get even weights."""

from dataclasses import replace

import numpy as np
import pytest
from support.gaussian_scenes import NAMES, circular, one_gaussian, small_model, spectral_model

from recon.data.measurements import Measurements
from recon.data.partial_volume import (
    KNOWN_TO,
    STEEPEST,
    correction_weights,
    excess_of_blocks,
    excess_of_pixels,
    neighbourhood_weights,
)
from recon.gaussians.model import Gaussians
from spectra.transmission import Transmission

GEOMETRY, FINER = circular(12, 14, views=2), 16
AIR = np.full((1, 20, 20), 1e5)


def sloped(along, across=0.0, rays=64):
    """Counts of pixels in which the line integral rises linearly, and those of its means."""
    fine = (np.arange(20 * rays) + 0.5) / rays
    rows, columns = np.exp(-across * fine), np.exp(-along * fine)
    counts = rows.reshape(20, rays).mean(axis=1)[:, None] * columns.reshape(20, rays).mean(axis=1)
    middle = np.arange(20) + 0.5
    return 1e5 * counts[None], 1e5 * np.exp(-across * middle)[None, :, None] * np.exp(-along * middle)


@pytest.mark.parametrize(("along", "across"), [(0.3, 0.0), (0.0, 0.35), (0.15, -0.2)])
def test_the_excess_of_a_linear_slope_is_exact(along, across):
    counts, means = sloped(along, across)
    inner = np.s_[:, 1:-1, 1:-1]
    found = excess_of_pixels(counts * 1e5, AIR * 1e5)[inner]  # without noise, as far as it can tell
    np.testing.assert_allclose(found, np.log(counts / means)[inner], rtol=2e-2, atol=1e-5)


@pytest.mark.parametrize("place", [0.25, 0.5, 0.7])
def test_an_edge_inside_of_a_pixel_has_more_excess_than_a_slope_through_it_but_not_more_than_a_step(place):
    height = 0.4
    lines = np.where(np.arange(20) < 9, 0.0, height)
    lines[9] = (1 - place) * height
    counts = 1e10 * np.exp(-lines) * np.ones((1, 20, 1))
    found = excess_of_pixels(counts, AIR * 1e5)[0, 10]
    step = np.log(place + (1 - place) * np.exp(-height)) + lines[9]
    slope = place * (1 - place) * height**2 / 24
    assert 3 * slope < found[9] < step
    assert not np.delete(found, 9).any()


def test_pixels_at_the_border_take_slopes_for_what_goes_on():
    counts, means = sloped(0.3)
    found = excess_of_pixels(counts * 1e5, AIR * 1e5)
    np.testing.assert_allclose(found[0, 10, [1, -2]], np.log(counts / means)[0, 10, [1, -2]], rtol=2e-2)
    assert not found[0, 10, [0, -1]].any()


@pytest.mark.parametrize("level", [30.0, 300.0, 1e5])
def test_noise_alone_has_next_to_no_excess(level):
    counts = np.random.default_rng(0).poisson(level, (1, 200, 200)).astype(np.float32)
    air = np.full(counts.shape, 1e5)
    assert excess_of_pixels(counts, air).mean() < 0.03 / level
    assert abs(excess_of_blocks(counts, air, 2).mean()) < 0.15 / level + 1e-5
    assert abs(excess_of_blocks(counts, air, 4).mean()) < 0.15 / level + 1e-5


def test_where_there_are_hardly_any_counts_nothing_is_corrected():
    counts = np.random.default_rng(0).poisson(1.0, (1, 20, 20)).astype(np.float32)
    assert excess_of_blocks(counts, AIR, 2)[counts.reshape(1, 10, 2, 10, 2).sum(axis=(2, 4)) < 20].max() == 0
    assert not excess_of_pixels(np.zeros_like(counts), AIR).any()


def test_steeper_slopes_than_can_be_told_are_bounded():
    counts = np.where(np.arange(20) < 10, 1e5, 0.0) * np.ones((1, 20, 1))
    counts[:, :, 10] = 100
    most = np.log(np.sinh(STEEPEST) / STEEPEST)
    assert excess_of_pixels(counts, AIR).max() == pytest.approx(most, rel=1e-5)


def test_blind_pixels_tell_nothing():
    counts = np.random.default_rng(0).poisson(1e4, (1, 20, 20)).astype(np.float32)
    air = AIR.copy()
    counts[0, 7, 8] = air[0, 7, 8] = 0
    assert excess_of_pixels(counts, air).max() < 0.01
    assert excess_of_blocks(counts, air, 2)[0, 3, 4] == pytest.approx(0, abs=1e-3)
    weights = neighbourhood_weights(counts, air)
    assert weights[0, 7, 8] == 0
    assert weights[0, 5:10, 6:11].min() == 0
    assert np.sort(weights[0, 5:10, 6:11].ravel())[1] > 0.9
    dark = excess_of_pixels(np.zeros((1, 4, 4)), np.zeros((1, 4, 4)))
    assert np.isfinite(dark).all()
    assert not dark.any()


def test_shares_of_even_rays_are_whole_and_those_beside_dark_ones_small():
    counts = np.full((1, 20, 20), 1e4, np.float32)
    counts[0, 9:12, 9:12] = 10
    weights = neighbourhood_weights(counts, AIR)
    assert weights[0, 10, 10] == 1
    assert weights[0, 8, 8] < 0.1
    np.testing.assert_allclose(weights[0, :, :6], 1, rtol=1e-3)


def test_rays_with_their_shares_have_as_much_say_as_the_most_attenuated_near_by():
    counts = 1e5 * np.exp(-np.linspace(0, 3, 20)) * np.ones((1, 20, 1))
    information = neighbourhood_weights(counts, AIR) * counts
    np.testing.assert_allclose(information[0, 5, 3:17], counts[0, 5, 5:19], rtol=0.02)


def test_channels_whose_correction_is_larger_lose_what_its_doubt_takes():
    soft, hard = (np.exp(-np.linspace(0, depth, 20)) * np.ones((20, 1)) for depth in (30.0, 10.0))
    counts = 1e6 * np.stack([soft, hard]).astype(np.float32)
    air = np.full(counts.shape, 1e6, np.float32)
    weights = correction_weights(counts, air, 0.02)[:, 10, 3:6]
    excess = excess_of_pixels(counts, air)[:, 10, 3:6]
    more = KNOWN_TO * (excess[0] - excess[1])
    variance = 1 / counts[0, 10, 3:6] + 0.02**2
    np.testing.assert_allclose(weights[0] * (variance + more**2), variance, rtol=1e-4)
    assert more.min() > 0.005
    np.testing.assert_array_equal(weights[1], 1)


def test_even_rays_and_those_without_counts_are_not_in_doubt():
    counts = np.random.default_rng(0).poisson(1e4, (2, 20, 20)).astype(np.float32)
    np.testing.assert_allclose(correction_weights(counts, np.full(counts.shape, 2e4), 0.02), 1, atol=0.01)
    counts[:, :, 8:] = 1
    weights = correction_weights(counts, np.full(counts.shape, 2e4), 0.02)
    np.testing.assert_array_equal(weights[:, :, 9:], 1)


def filtered(model):
    """The same model with the column of a filter."""
    energy = np.linspace(25, 115, len(model.weights))
    return Transmission(np.vstack([model.columns, (50 / energy) ** 2.5]), model.weights, model.starts)


def scan_of(model, geometry, pixels, profile=None, gain=1.3):
    """Counts as a detector sums them, means of the intensities of many rays in each pixel; and of their means."""
    transmission = spectral_model(3) if profile is None else filtered(spectral_model(3))
    lengths = model.line_integrals(geometry.subdivided(FINER)).numpy().astype(float)
    rows, columns = pixels
    lengths = np.moveaxis(lengths, 1, -1).reshape(len(lengths), rows, FINER, columns, FINER, 3)
    if profile is not None:
        known = np.moveaxis(profile, 0, -1)[:, None, :, None]
        lengths = np.concatenate([lengths, np.broadcast_to(known, (*lengths.shape[:-1], len(profile)))], axis=-1)
    counts = np.moveaxis(transmission.expected(lengths).mean(axis=(2, 4)), -1, 1) * gain
    wanted = np.moveaxis(transmission.expected(lengths.mean(axis=(2, 4))), -1, 1) * gain
    gains = np.full((4, rows, columns), gain, np.float32)
    exposure = np.ones((len(counts), 4))
    found = Measurements(counts.astype(np.float32), gains, exposure, geometry, transmission, NAMES, profile)
    return found, replace(found, counts=wanted.astype(np.float32))


@pytest.mark.parametrize("with_profile", [False, True])
def test_pixels_and_sums_of_them_become_those_of_mean_line_integrals(with_profile):
    dense = Gaussians(*(part.float() for part in one_gaussian([0.3, -0.2, 0.1], [1.5, 1.2, 2.5], 3)), NAMES)
    dense = replace(dense, coefficients=dense.coefficients * 0.1)
    profile = np.linspace(-0.3, 0.7, 24 * 28).reshape(1, 24, 28) if with_profile else None
    scan, means = scan_of(dense, GEOMETRY.subdivided(2), (24, 28), profile)
    scan, means = (replace(s, counts=s.counts * 1e4, gains=s.gains * 1e4) for s in (scan, means))
    off, left = (np.log(s.counts / means.counts) for s in (scan, scan.without_partial_volume()))
    assert off.max() > 0.005
    assert np.sqrt((left**2).mean()) < 0.3 * np.sqrt((off**2).mean())
    lengths = dense.line_integrals(GEOMETRY.subdivided(2 * FINER)).numpy().astype(float)
    lengths = lengths.reshape(2, 3, 12, 2 * FINER, 14, 2 * FINER).mean(axis=(3, 5))
    coarse = scan.without_partial_volume().binned(2)
    expected = coarse.transmission.expected(coarse.with_profile(np.moveaxis(lengths, 1, -1)))
    summed = scan.counts.reshape(2, 4, 12, 2, 14, 2).sum(axis=(3, 5))
    wanted = np.moveaxis(expected, -1, 1) * coarse.gains
    off, left = (np.log(counts / wanted) for counts in (summed, coarse.counts))
    assert off.max() > 0.05
    assert np.sqrt((left**2).mean()) < 0.35 * np.sqrt((off**2).mean())


def test_air_and_blind_pixels_stay_as_they_are():
    scan, _ = scan_of(small_model(3, count=1, height=0.0), GEOMETRY, (12, 14))
    scan.counts[:, :, 3, 4], scan.gains[:, 3, 4] = 0, 0
    np.testing.assert_allclose(scan.without_partial_volume().counts, scan.counts, rtol=1e-5)


def test_views_that_a_channel_did_not_take_stay_empty():
    scan, _ = scan_of(small_model(3), GEOMETRY, (12, 14))
    scan.counts[0, 1], scan.exposure[0, 1] = 0, 0
    for changed in (scan.without_partial_volume(), scan.binned(2), scan.weighted(0.02)):
        assert np.isfinite(changed.counts).all()
        assert not changed.counts[0, 1].any()
    assert not scan.weighted(0.02).statistical_weights[0, 1].any()


def test_some_views_take_their_shares_along():
    scan, _ = scan_of(small_model(3), GEOMETRY, (12, 14))
    weighted = scan.weighted(0.02)
    np.testing.assert_array_equal(weighted[[1]].statistical_weights, weighted.statistical_weights[[1]])
    assert weighted.binned(2).statistical_weights is None
