"""ElectronicNoise: offset and noise of readings, darks, and what contradicts them."""

import numpy as np
import pytest
from support.detector_scenes import counting, frames, integrating, views_of

from phantomgen.effects import ElectronicNoise
from phantomgen.effects.random_streams import Stream
from spectra.errors import InputError, SceneError

NOISY = "effects.electronics={sigma: 300, offset: 5000}"


def test_readings_have_the_stated_mean_and_noise():
    signal = np.full((200, 200), 1000.0)
    read = ElectronicNoise(30.0, 500.0).reading(signal, 1, 0, 0)
    assert abs(read.mean() - 1500) < 5 * 30 / 200
    assert abs(read.std() / 30 - 1) < 5 / np.sqrt(2 * read.size)
    np.testing.assert_array_equal(ElectronicNoise(0.0, 500.0).reading(signal, 1, 0, 0), 1500.0)


def test_noise_of_frames_streams_channels_and_neighbours_is_independent():
    zero, electronics = np.zeros((100, 100)), ElectronicNoise(1.0)
    keys = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
    images = [electronics.reading(zero, *key) for key in keys]
    images += [electronics.reading(zero, 0, 0, 0, stream) for stream in (Stream.FLAT, Stream.DARK)]
    correlation = np.corrcoef([image.ravel() for image in images]) - np.eye(len(images))
    assert abs(correlation).max() < 5 / 100
    assert max(abs(np.mean(x[1:] * x[:-1])) for x in (images[0], images[0].T)) < 5 / 99


def test_flats_hold_photon_noise_and_noise_of_their_own_and_darks_the_latter():
    views = views_of(integrating(NOISY, "flats=40"))
    quiet = frames(views_of(integrating("flats=40")), Stream.FLAT, 40)
    flats, darks = (frames(views, stream, 40) for stream in (Stream.FLAT, Stream.DARK))
    added = flats - quiet  # photons have the same random numbers in both
    for noise in (added, darks):
        assert abs(noise.mean() - 5000) < 5 * 300 / np.sqrt(noise.size)
        assert abs(noise.std() / 300 - 1) < 5 / np.sqrt(2 * noise.size)
    assert abs(np.corrcoef(added.ravel(), quiet.ravel())[0, 1]) < 5 / np.sqrt(added.size)


def test_without_noise_only_the_offset_is_left():
    views = views_of(integrating(NOISY, "noise=false"))
    np.testing.assert_array_equal(frames(views, Stream.DARK, 1), 5000.0)


@pytest.mark.parametrize("bad", [{"sigma": -1.0}, {"sigma": 1.0, "offset": np.inf}])
def test_impossible_electronics_are_refused(bad):
    with pytest.raises(InputError, match="electronics must be finite and not negative"):
        ElectronicNoise(**bad)


@pytest.mark.parametrize(
    ("make", "settings", "words"),
    [
        (counting, [NOISY], r"effects\.electronics - electronics stays below the thresholds of detectors that count"),
        (integrating, [NOISY, "darks=0"], r"electronics\.offset - needs darks to be taken off again, got darks: 0"),
        (integrating, ["effects.electronics.sigma=-1"], r"effects\.electronics\.sigma"),
    ],
)
def test_a_scene_names_what_contradicts(make, settings, words):
    with pytest.raises(SceneError, match=words):
        make(*settings)
