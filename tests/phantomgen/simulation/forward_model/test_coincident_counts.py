"""Counts of neighbouring pixels: their means, variances and covariances over many frames."""

import numpy as np
import pytest
from support.detector_scenes import counting, views_of

from phantomgen.effects.random_streams import Stream
from phantomgen.simulation.forward_model.photon_noise import coincident_counts
from spectra.errors import SceneError

FRAMES = 300
MEAN = np.array([50.0, 20.0])
# A tenth of the counts has a partner on each side, and a part of these across a corner.
SHARES = np.zeros((2, 2, 2, 2))
SHARES[0, 0, 0, 0], SHARES[0, 0, 1, 1], SHARES[0, 1, 0, 1] = 0.04, 0.03, 0.03
SHARES[1, 0, 0, 0] = 0.02
PAIRS = SHARES @ MEAN


def drawn(mean, sensor_pixels):
    return np.array([coincident_counts(mean, SHARES, sensor_pixels, 3, frame) for frame in range(FRAMES)])


def covariance(values, down, right):
    """Covariance of channels of a pixel and of the one so far down and right, (channel, channel)."""
    rows, columns = values.shape[2:]
    here = values[:, :, : rows - down, max(-right, 0) : columns - max(right, 0)]
    there = values[:, :, down:, max(right, 0) : columns + min(right, 0)]
    return np.einsum("fayx,fbyx->ab", here, there) / here[:, 0].size


@pytest.fixture(scope="module", params=[(1.0, 1.0), (2.0, 4.0)])
def panel(request):
    mean = np.broadcast_to(MEAN[:, None, None], (2, 30, 30)).copy()
    return request.param, drawn(mean, request.param) - mean


def test_means_are_those_that_are_expected(panel):
    _, off = panel
    assert np.abs(off.mean(axis=(0, 2, 3))).max() < 5 * np.sqrt(1.5 * MEAN[0] / off[:, 0].size)
    edge = off[:, :, :, 0]
    assert np.abs(edge.mean(axis=(0, 2))).max() < 5 * np.sqrt(1.5 * MEAN[0] / edge[:, 0].size)


def test_covariances_count_the_photons_that_both_have(panel):
    (down, right), off = panel
    edge, corner = PAIRS
    inside = (2 - 1 / down - 1 / right) * edge + 2 * (1 - 1 / down) * (1 - 1 / right) * corner
    expected = {
        (0, 0): np.diag(MEAN) + 2 * inside,
        (0, 1): edge / right + 2 * (1 - 1 / down) / right * corner,
        (1, 0): edge / down + 2 * (1 - 1 / right) / down * corner,
        (1, 1): corner / (down * right),
        (1, -1): corner / (down * right),
        (0, 2): np.zeros((2, 2)),
    }
    for step, values in expected.items():
        noise = np.sqrt(np.outer(MEAN, MEAN) / off[:, 0].size) * 1.6
        assert (np.abs(covariance(off, *step) - values) < 5 * noise).all(), step


def test_an_edge_of_the_object_changes_no_mean():
    mean = np.broadcast_to(MEAN[:, None, None], (2, 8, 8)).copy()
    mean[:, :, 4:] /= 1000
    off = drawn(mean, (1.0, 1.0)).mean(axis=0) - mean
    assert (np.abs(off) < 5 * np.sqrt(mean / FRAMES)).all()


def test_counts_of_a_frame_do_not_depend_on_others():
    mean = np.broadcast_to(MEAN[:, None, None], (2, 8, 8)).copy()
    again = coincident_counts(mean, SHARES, (1.0, 1.0), 3, 1)
    assert np.array_equal(drawn(mean, (1.0, 1.0))[1], again)
    assert not np.array_equal(drawn(mean, (1.0, 1.0))[0], again)


REAL = (
    "detector.resolution=4.7",
    "detector.fluorescence=true",
    "detector.charge_sharing={pitch: 0.25, cloud: 0.018}",
    "panel.pitch=0.5",
)


def test_a_scan_with_shared_charge_has_correlated_neighbours():
    together, apart = views_of(counting(*REAL)), views_of(counting(*REAL, "detector.charge_sharing.covariance=false"))
    assert apart.detector.coincidences is None
    assert together.detector.warnings == []
    expected = together.expected(0, Stream.FLAT)
    shares = together.detector.coincidences.shares
    inside = shares[0] @ expected[:, 0, 0] + 0.5 * shares[1] @ expected[:, 0, 0]
    off = np.stack([np.stack(together.registered(expected, f, Stream.FLAT)) for f in range(40)]) - expected
    found = covariance(off, 0, 0)
    np.testing.assert_allclose(
        found, np.diag(expected[:, 0, 0]) + 2 * inside, atol=6 * expected[0, 0, 0] * np.sqrt(2 / off[:, 0].size)
    )
    assert (np.diag(found) > 1.05 * expected[:, 0, 0]).any()
    mean = together.registered(expected, 0, Stream.FLAT, noise=False)
    assert np.array_equal(mean, apart.registered(expected, 0, Stream.FLAT, noise=False))


DEAD = "detector.dead_time={tau_ns: 20, exposure_ms: 0.5}"


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (
            (*REAL, "detector.charge_sharing.covariance=true", DEAD),
            "covariance - is not known for a detector with dead",
        ),
        ((*REAL, "detector.charge_sharing.covariance=true", "panel.pitch=0.1"), "must not be larger than that of the"),
    ],
)
def test_covariance_that_is_not_known_is_refused(settings, words):
    with pytest.raises(SceneError, match=words):
        counting(*settings)


@pytest.mark.parametrize("setting", [DEAD, "panel.pitch=0.1"])
def test_counts_are_independent_where_nothing_else_is_known(setting):
    assert not counting(*REAL, setting).detector.charge_sharing.covariance
