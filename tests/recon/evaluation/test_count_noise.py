"""Noise of predicted counts: what a finite number of flats adds."""

import numpy as np
import pytest
from support.tiny_scans import make

from phantomgen.dataset.reader import open_dataset
from recon.data.measurements import read_measurements
from recon.evaluation.count_noise import CountNoise, flat_noise
from recon.evaluation.metrics import HeldOutView, score_projections


@pytest.fixture(scope="module")
def few_flats(tmp_path_factory):
    with open_dataset(make(tmp_path_factory.mktemp("flats") / "scan.h5", "--views", "6", "--set", "flats=2")) as found:
        yield found


def test_relative_variance_of_the_flats_is_that_of_the_gains(few_flats):
    gains = read_measurements(few_flats, np.array([0])).gains
    ratio = np.mean((gains - 1) ** 2, axis=(1, 2)) / np.mean(flat_noise(few_flats), axis=(1, 2))
    np.testing.assert_allclose(ratio, 1.0, atol=5 * np.sqrt(2 / gains[0].size))


def test_rays_through_air_score_one_with_two_flats(few_flats):
    noise, views = CountNoise.of(few_flats), []
    for view in few_flats.splits["train"]:
        measured = read_measurements(few_flats, np.array([view]))
        expected = measured.gains * measured.open_beam * measured.exposure[0][:, None, None]
        air = np.abs(np.arange(32) - 15.5) > 14.5  # outermost columns
        away = np.broadcast_to(air, expected.shape[1:])
        views.append(HeldOutView(measured.counts[0], expected, expected, away, spread=noise.spread(expected)))
    for channel in score_projections(views, few_flats.spectra.channels).values():
        assert channel["chi_square_away"] == pytest.approx(1.0, abs=0.35)  # two columns of 32 gains each


def test_one_flat_is_taken_as_exact(tmp_path):
    with open_dataset(make(tmp_path / "scan.h5", "--views", "3", "--set", "flats=1")) as dataset:
        assert not flat_noise(dataset).any()
        expected = dataset.flat
        np.testing.assert_array_equal(CountNoise.of(dataset).spread(expected), 1.0)


def test_scattered_counts_have_no_noise_of_the_flats(few_flats):
    noise = CountNoise.of(few_flats)
    primary = few_flats.flat
    alone = noise.spread(primary) - 1
    np.testing.assert_allclose(noise.spread(primary, 3 * primary) - 1, alone / 4)
