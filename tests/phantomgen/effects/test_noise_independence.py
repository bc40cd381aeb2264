"""Noise of counts and of summed energies: mean, variance, and independence, all at five standard deviations."""

import numpy as np
import pytest
from support.detector_scenes import counting, flats, frames, integrating, views_of

from phantomgen.effects.random_streams import Stream

LARGE = ["panel.rows=100", "panel.columns=110", "flats=6"]
QUANTA = np.array([40.0, 60.0, 80.0])


def standardized(scan):
    """Flats less their mean, over their standard deviation by the model of photons."""
    views = views_of(scan)
    beam = views.exposure.transmission.open_beam
    quantum = 1.0
    if views.exposure.quanta is not None:
        means = views.exposure.groups.open_beam
        quantum = (means * views.exposure.quanta).sum() / means.sum()
    noise = (frames(views, Stream.FLAT, 6) - beam[:, None, None]) / np.sqrt(quantum * beam)[:, None, None]
    return noise[:, beam > 0]


SCANS = {"counts": counting(*LARGE), "energies": integrating(*LARGE)}


@pytest.fixture(scope="module", params=SCANS)
def noise(request):
    return standardized(SCANS[request.param])


def test_mean_and_variance_are_those_of_the_model(noise):
    assert abs(noise.mean()) < 5 / np.sqrt(noise.size)
    # The fourth moment of such a sum of many photons is 3 to within 1 / 1000.
    assert abs(noise.var() - 1) < 5 * np.sqrt(2.01 / noise.size)


@pytest.mark.parametrize("shift", [(0, 1), (1, 0), (1, 1), (1, -1), (0, 2)])
def test_neighbours_are_independent(noise, shift):
    other = np.roll(noise, shift, axis=(2, 3))
    assert abs(np.mean(noise * other)) < 5 / np.sqrt(noise.size)


def test_frames_are_independent(noise):
    assert abs(np.mean(noise[1:] * noise[:-1])) < 5 / np.sqrt(noise[1:].size)


def test_channels_are_independent():
    noise = standardized(SCANS["counts"])
    assert noise.shape[1] == 3
    for a, b in ((0, 1), (0, 2), (1, 2)):
        assert abs(np.mean(noise[:, a] * noise[:, b])) < 5 / np.sqrt(noise[:, 0].size)


def test_squares_of_neighbours_are_independent(noise):
    """Linked variances would not show in correlations."""
    square = noise**2 - 1
    assert abs(np.mean(square[..., 1:] * square[..., :-1])) < 5 * 2.01 / np.sqrt(square[..., 1:].size)


def test_views_and_flats_share_nothing():
    views = views_of(counting(*LARGE, "geometry.views=6"))
    air = np.s_[:, :, :, :15]  # beside the sphere
    one, other = (frames(views, stream, 6)[air] for stream in (Stream.PROJECTION, Stream.FLAT))
    one, other = (x - x.mean(axis=(0, 2, 3), keepdims=True) for x in (one, other))
    assert abs(np.mean(one * other) / (one.std() * other.std())) < 5 / np.sqrt(one.size)


def test_effects_that_are_off_change_no_count():
    plain = flats(counting(*LARGE), 1)
    off = counting(*LARGE, "effects.gain={}", "effects.defects={}")
    np.testing.assert_array_equal(flats(off, 1), plain)
