"""Gain maps: their statistics, where they act, and that flats take them away unless they drift."""

import numpy as np
import pytest
from support.detector_scenes import counting, flats, frames, integrating, views_of

from phantomgen.effects import Gain
from phantomgen.effects.random_streams import Stream
from spectra.errors import InputError, SceneError

FLAT, VIEW = Stream.FLAT, Stream.PROJECTION


def test_every_part_of_a_map_has_its_standard_deviation():
    size = 200
    plain = Gain(sigma=0.02).maps(3, 1, size, size)[0]
    assert abs(plain.mean() - 1) < 5 * 0.02 / size
    assert abs(plain.std() / 0.02 - 1) < 5 / np.sqrt(2 * plain.size)
    z = (plain - 1) / 0.02
    assert max(abs(np.mean(z[1:] * z[:-1])), abs(np.mean(z[:, 1:] * z[:, :-1]))) < 5 / size
    columns = Gain(columns=0.02).maps(3, 1, size, size)[0]
    assert (columns == columns[0]).all()
    assert abs(columns[0].std() / 0.02 - 1) < 5 / np.sqrt(2 * size)
    smooth = Gain(smooth=0.02).maps(3, 1, size, size)[0]
    assert smooth.std() == pytest.approx(0.02, rel=1e-9)
    assert abs(np.diff(smooth, axis=0)).max() < 0.02 * 0.2
    np.testing.assert_array_equal(Gain(smooth=0.1).maps(3, 1, 1, 1), 1.0)


def test_a_map_belongs_to_seed_and_channel_and_to_nothing_else():
    gain = Gain(sigma=0.05)
    three = gain.maps(1, 3, 20, 20)
    np.testing.assert_array_equal(three[:2], gain.maps(1, 2, 20, 20))
    assert (three[0] != three[1]).all()
    assert (three[0] != gain.maps(2, 1, 20, 20)[0]).all()
    np.testing.assert_array_equal(gain.maps(1, 1, 20, 20, FLAT), gain.maps(1, 1, 20, 20, VIEW))


def test_drift_changes_views_and_leaves_flats():
    steady, drifting = Gain(0.05), Gain(0.05, drift=0.01)
    np.testing.assert_array_equal(drifting.maps(1, 1, 99, 99, FLAT), steady.maps(1, 1, 99, 99, FLAT))
    ratio = drifting.maps(1, 1, 99, 99, VIEW) / steady.maps(1, 1, 99, 99, VIEW) - 1
    assert abs(ratio.std() / 0.01 - 1) < 5 / np.sqrt(2 * ratio.size)
    np.testing.assert_array_equal(Gain(0.05, in_flats=False).maps(1, 1, 9, 9, FLAT), 1.0)


@pytest.mark.parametrize("make", [counting, integrating])
def test_flat_field_correction_takes_the_map_away_and_leaves_the_drift(make):
    settings = ["effects.gain={sigma: 0.1, columns: 0.05, smooth: 0.05}", "noise=false", "effects.blur.fwhm=2"]
    plain = make("noise=false", "effects.blur.fwhm=2")
    steady, drifting = make(*settings), make(*settings, "effects.gain.drift=0.02")
    corrected = [
        frames(views_of(scan), VIEW, 1)[0] / frames(views_of(scan), FLAT, 1)[0] for scan in (plain, steady, drifting)
    ]
    np.testing.assert_allclose(corrected[1], corrected[0], rtol=1e-5)
    left = corrected[2] / corrected[0] - 1
    assert abs(left.std() / 0.02 - 1) < 5 / np.sqrt(2 * left.size)


@pytest.mark.parametrize(("make", "power"), [(counting, 1), (integrating, 2)])
def test_noise_follows_the_gain_as_photons_or_as_an_amplifier(make, power):
    scan = make("effects.gain={columns: 0.2}", "panel.rows=250", "panel.columns=12", "flats=20")
    found, mean = flats(scan, 20)[:, 0], flats(scan, 1, noise=False)[0, 0]
    plain = flats(make("flats=1"), 1, noise=False)[0, 0, 0, 0]
    noise = ((found - mean) ** 2).mean(axis=(0, 1)) / plain
    gain = mean[0] / plain
    quantum = 1.0 if power == 1 else (40**2 + 60**2 + 80**2) / (40 + 60 + 80)
    np.testing.assert_allclose(noise / quantum, gain**power, rtol=5 * np.sqrt(2 / 5000) + 0.01)


@pytest.mark.parametrize("bad", [{"sigma": -0.1}, {"columns": 0.3}, {"drift": np.nan}])
def test_impossible_maps_are_refused(bad):
    with pytest.raises(InputError, match="gain map must lie in 0"):
        Gain(**bad)


def test_a_scene_names_what_is_wrong():
    with pytest.raises(SceneError, match=r"effects\.gain\.smooth"):
        counting("effects.gain.smooth=0.5")
