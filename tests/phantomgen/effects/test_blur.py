"""Blur: its MTF, edges against the error function, and noise of the two kinds of detectors."""

import numpy as np
import pytest
from scipy.special import erf
from support.detector_scenes import counting, flats, frames, integrating, views_of

from phantomgen.effects import Blur
from phantomgen.effects.blur import blurred, sampled_gaussian
from phantomgen.effects.random_streams import Stream
from phantomgen.geometry.panel import Panel
from spectra.errors import InputError, SceneError

WIDE = "effects.blur.fwhm=3.5"  # 1.5 pixels


def transfer(weights, frequency):
    """Fourier transform of a kernel at frequencies [1/pixel]."""
    steps = np.arange(len(weights)) - len(weights) // 2
    return np.cos(2 * np.pi * np.outer(frequency, steps)) @ weights


def step(x, sigma):
    """A unit step blurred by `sigma`, averaged over pixels of width 1 around x: an integral of the error function."""

    def integral(x):
        z = x / (np.sqrt(2) * sigma)
        return x * (1 + erf(z)) / 2 + sigma / np.sqrt(2 * np.pi) * np.exp(-(z**2))

    return integral(x + 0.5) - integral(x - 0.5)


def test_the_value_of_the_mtf_and_the_width_say_the_same():
    blur = Blur.of_mtf(0.2, 2.0)
    assert blur.mtf(np.array([2.0]))[0] == pytest.approx(0.2)
    assert Blur.of_fwhm(2 * np.sqrt(2 * np.log(2)) * blur.sigma).sigma == pytest.approx(blur.sigma)
    half = np.sqrt(2 * np.log(2)) * blur.sigma  # where the point spread has fallen to a half
    assert np.exp(-(half**2) / (2 * blur.sigma**2)) == pytest.approx(0.5)


@pytest.mark.parametrize("sigma", [0.01, 0.3, 0.5, 0.7, 1.0, 2.5, 10.0])
def test_kernels_are_positive_keep_the_mass_and_have_the_stated_width(sigma):
    weights = sampled_gaussian(sigma)
    steps = np.arange(len(weights)) - len(weights) // 2
    assert weights.min() >= 0
    assert weights.sum() == pytest.approx(1, abs=1e-14)
    assert (steps**2 * weights).sum() == pytest.approx(sigma**2, rel=1e-9)


@pytest.mark.parametrize(("sigma", "error"), [(0.3, 0.016), (0.5, 0.018), (0.7, 4e-3), (1.0, 1e-4), (3.0, 1e-5)])
def test_the_mtf_of_kernels_is_gaussian_up_to_half_the_nyquist_frequency(sigma, error):
    frequency = np.linspace(0, 0.25, 26)
    found = transfer(sampled_gaussian(sigma), frequency)
    np.testing.assert_allclose(found, np.exp(-2 * (np.pi * sigma * frequency) ** 2), atol=error)


@pytest.mark.parametrize("sigma", [0.5, 1.0, 2.0])
def test_an_edge_becomes_an_error_function(sigma):
    x = np.arange(-40, 40) + 0.3
    image = np.broadcast_to(step(x, 1.0), (3, len(x)))
    kernel = sampled_gaussian(sigma)
    found = blurred(image, (kernel, kernel))
    inside = slice(15, -15)
    np.testing.assert_allclose(found[1, inside], step(x, np.hypot(1.0, sigma))[inside], atol=2e-3)
    assert abs(found[1, inside] - step(x, 1.0)[inside]).max() > 0.02


def test_nothing_is_lost_at_the_border_of_the_panel_and_an_even_beam_stays_even():
    kernels = sampled_gaussian(2.0), sampled_gaussian(3.0)
    image = np.random.default_rng(1).uniform(0, 1, (7, 9))  # smaller than the kernel
    assert blurred(image, kernels).sum() == pytest.approx(image.sum(), rel=1e-12)
    np.testing.assert_allclose(blurred(np.full((7, 9), 5.0), kernels), 5.0, rtol=1e-12)


def test_oblong_pixels_are_blurred_by_millimetres():
    along_columns, along_rows = Blur(1.0).kernels(Panel(8, 8, (2.0, 0.5)))
    assert len(along_columns) < len(along_rows)
    np.testing.assert_array_equal(along_rows, sampled_gaussian(2.0))


def test_counts_of_neighbours_stay_independent_and_poisson():
    counts = flats(counting(WIDE, "panel.rows=120", "panel.columns=120"))
    mean = counts.mean(axis=(0, 2, 3), keepdims=True)
    z = (counts - mean) / np.sqrt(mean)
    assert z.var() == pytest.approx(1, abs=5 * np.sqrt(2 / z.size))
    for a, b in ((z[..., 1:], z[..., :-1]), (z[:, :, 1:], z[:, :, :-1])):
        assert abs(np.mean(a * b)) < 5 / np.sqrt(a.size)


def test_the_noise_power_of_blurred_light_falls_as_the_square_of_the_mtf():
    size, count, border = 120, 6, 10  # mirrored borders are left out
    large = f"panel.rows={size}", f"panel.columns={size}", f"flats={count}"
    sharp, soft = (flats(integrating(*large, *more), count)[:, 0] for more in ([], [WIDE]))
    window = np.outer(*[np.hanning(size - 2 * border)] * 2)
    inner = np.s_[:, border:-border, border:-border]
    power = [(abs(np.fft.fft2(window * (x - x.mean())[inner])) ** 2).mean(axis=0) for x in (sharp, soft)]
    frequency = np.fft.fftfreq(len(window))
    ring = np.hypot(*np.meshgrid(frequency, frequency))
    sigma = Blur.of_fwhm(3.5).sigma
    for low, high in ((0.02, 0.06), (0.06, 0.1), (0.1, 0.14), (0.14, 0.18), (0.18, 0.22)):
        inside = (ring >= low) & (ring < high)
        wanted = np.exp(-4 * (np.pi * sigma * ring[inside]) ** 2)
        # A power has the standard deviation of its mean; each stands twice, and the window links 4 in 2 dimensions.
        noise = 5 * np.sqrt(2 * 4 / (inside.sum() * count))
        assert np.mean(power[1][inside] / wanted) / power[0].mean() == pytest.approx(1, abs=noise)
        assert power[0][inside].mean() / power[0].mean() == pytest.approx(1, abs=noise)


def test_the_mean_of_blurred_signals_is_the_blurred_mean():
    for scan in (counting(WIDE), integrating(WIDE)):
        views, sharp = views_of(scan), views_of(integrating() if scan.detector.units == "keV" else counting())
        kernels = Blur.of_fwhm(3.5).kernels(scan.geometry.panel)
        found, plain = (frames(v, Stream.PROJECTION, 1, noise=False)[0] for v in (views, sharp))
        np.testing.assert_allclose(found, [blurred(image, kernels) for image in plain], rtol=1e-6)


@pytest.mark.parametrize("make", [lambda: Blur(0.0), lambda: Blur.of_mtf(1.0, 2.0), lambda: Blur.of_fwhm(-1.0)])
def test_impossible_widths_are_refused(make):
    with pytest.raises(InputError):
        make()


@pytest.mark.parametrize("given", ["{mtf: 0.2}", "{}", "{mtf: 0.2, frequency: 1, fwhm: 1}", "{frequency: 1, fwhm: 1}"])
def test_a_scene_gives_either_the_mtf_or_the_width(given):
    with pytest.raises(SceneError, match=r"effects\.blur - give mtf with its frequency in 1/mm, or fwhm in mm alone"):
        counting(f"effects.blur={given}")
