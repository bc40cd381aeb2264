"""Model observers against closed forms of d': white noise, coloured noise, known means; coverage of the interval."""

import numpy as np
import pytest

from recon.quality.observers import (
    CHANNELS,
    channelised_hotelling,
    channels,
    hotelling,
    ideal_square,
    without_prewhitening,
)
from spectra.errors import InputError

SIDE, CENTRE = 24, (11.5, 11.25)


def disk(radius=3.0, height=1.0):
    rows, columns = np.ogrid[:SIDE, :SIDE]
    apart = np.hypot(rows - CENTRE[0], columns - CENTRE[1])
    return height * np.clip(radius + 0.5 - apart, 0, 1)


def images(count, seed, sigma=1.0, signal=None):
    found = sigma * np.random.default_rng(seed).standard_normal((count, SIDE, SIDE))
    return found if signal is None else found + signal


def coloured(noise):
    """Noise that a periodic blur makes from white noise, and the eigenvalues of its covariance, by frequency."""
    frequency = np.fft.fftfreq(SIDE)
    transfer = np.exp(-20 * (frequency[:, None] ** 2 + frequency[None] ** 2))
    return np.fft.ifft2(np.fft.fft2(noise) * transfer).real, transfer**2


@pytest.mark.parametrize("distance", [0.5, 2.0, 6.0])
@pytest.mark.parametrize(("features", "count"), [(1, 8), (3, 8), (3, 40)])
def test_the_estimate_is_unbiased_and_its_interval_covers_the_truth(features, count, distance):
    rng, trials = np.random.default_rng(1), 400
    mixing = rng.standard_normal((features, features)) + 2 * np.eye(features)
    signal = mixing @ np.full(features, distance / np.sqrt(features))
    covered, squares = 0, []
    for _ in range(trials):
        noise = rng.standard_normal((2, count, features)) @ mixing.T
        found = hotelling(noise[0] + signal, noise[1])
        covered += found.low <= distance <= found.high
        squares.append(found.value**2)
    assert covered / trials == pytest.approx(0.95, abs=0.035)
    if distance > 1:  # smaller ones are cut off at 0
        assert np.mean(squares) == pytest.approx(distance**2, abs=4 * np.std(squares) / np.sqrt(trials))


def test_the_interval_of_eight_pairs_is_as_wide_as_the_page_says():
    rng, ends = np.random.default_rng(0), []
    for _ in range(300):
        present, absent = rng.standard_normal((2, 8, CHANNELS))
        present[:, 0] += 3
        found = hotelling(present, absent)
        ends.append((found.low, found.high))
    assert np.median(ends, axis=0) == pytest.approx([1.3, 4.6], abs=0.1)


def test_without_prewhitening_in_white_noise_d_is_the_norm_of_the_signal_over_the_noise():
    signal = disk(height=0.8)
    found = without_prewhitening(images(400, 1, signal=signal), images(400, 2), CENTRE)
    expected = float(np.linalg.norm(signal))
    assert found.low < expected < found.high
    assert found.value == pytest.approx(expected, rel=0.1)


def test_without_prewhitening_few_images_give_a_lower_d_by_a_quarter_at_most():
    signal = disk(height=0.5)
    found = [
        without_prewhitening(images(8, seed, signal=signal), images(8, 1000 + seed), CENTRE).value
        for seed in range(100)
    ]
    assert 0.75 < np.mean(found) / np.linalg.norm(signal) < 1.0


def test_without_prewhitening_in_coloured_noise_d_is_that_of_the_noise_power_spectrum():
    """Barrett & Myers 13.2.12: d'^2 = (s^T s)^2 / s^T K s, with K diagonal in frequency."""
    signal = disk(height=0.3)
    (present, power), (absent, _) = coloured(images(600, 3)), coloured(images(600, 4))
    found = without_prewhitening(present + signal, absent, CENTRE)
    spectrum = np.abs(np.fft.fft2(signal)) ** 2 / SIDE**2
    assert found.value == pytest.approx(spectrum.sum() / np.sqrt((spectrum * power).sum()), rel=0.1)


def test_channels_have_the_transfer_of_differences_of_gaussians_and_no_mean():
    templates = channels((SIDE, SIDE), (0.0, 0.0))
    frequency = np.fft.fftfreq(SIDE)
    radius = np.hypot(frequency[:, None], frequency[None])
    for j, template in enumerate(templates):
        width = 0.015 * 2**j
        expected = np.exp(-0.5 * (radius / (2 * width)) ** 2) - np.exp(-0.5 * (radius / width) ** 2)
        np.testing.assert_allclose(np.fft.fft2(template), expected, atol=1e-12)
    assert np.abs(templates.sum(axis=(1, 2))).max() < 1e-12
    moved = channels((SIDE, SIDE), (5.0, 7.0))
    np.testing.assert_allclose(moved, np.roll(templates, (5, 7), axis=(1, 2)), atol=1e-12)


def test_the_channelised_hotelling_observer_in_white_noise_is_a_projection_onto_its_channels():
    signal = disk(height=0.8)
    found = channelised_hotelling(images(2000, 5, signal=signal), images(2000, 6), CENTRE)
    templates = channels((SIDE, SIDE), CENTRE).reshape(CHANNELS, -1)
    outputs = templates @ signal.ravel()
    expected = np.sqrt(outputs @ np.linalg.solve(templates @ templates.T, outputs))
    assert found.value == pytest.approx(expected, rel=0.05)
    assert expected < np.linalg.norm(signal)  # the ideal observer of white noise


def test_the_ideal_observer_of_poisson_counts_decides_as_its_likelihood_ratio_does():
    """Class means of the logarithm of the likelihood ratio differ by d'^2, and its variance is d'^2."""
    rng = np.random.default_rng(7)
    absent = rng.uniform(50, 200, 400)
    present = absent * (1 + 0.01 * rng.standard_normal(400))
    square = ideal_square(present, absent, (present + absent) / 2)
    ratio = [
        rng.poisson(mean, (20000, 400)) @ np.log(present / absent) - (present - absent).sum()
        for mean in (present, absent)
    ]
    assert ratio[0].mean() - ratio[1].mean() == pytest.approx(square, rel=0.03)
    assert ratio[1].var() == pytest.approx(square, rel=0.05)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: hotelling(np.zeros((2, 3)), np.zeros((2, 3))), "7 images or more, got 2 with and 2"),
        (lambda: hotelling(np.zeros((9, 3)), np.zeros((9, 3))), "needs images with noise"),
        (lambda: without_prewhitening(images(3, 1), images(3, 2), CENTRE), "4 images or more of each class"),
        (lambda: without_prewhitening(images(5, 1), images(4, 2), CENTRE), "got 5 and 4"),
    ],
)
def test_too_few_images_are_refused(call, words):
    with pytest.raises(InputError, match=words):
        call()
