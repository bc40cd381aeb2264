"""Regions, profiles, noise power and edges have the values of closed forms."""

import subprocess
import sys

import numpy as np
import pytest
from scipy.special import ndtr

from phantomgen.geometry.voxel_grid import Grid
from recon import quality
from spectra.errors import InputError

GRID = Grid((6, 32, 40), (2.0, 1.0, 0.5), (-5.0, -15.5, -9.75))


def test_a_profile_of_a_plane_is_linear_between_voxels_and_unknown_outside():
    z, y, x = np.meshgrid(*(GRID.axis(axis) for axis in "zyx"), indexing="ij")
    line = quality.profile(3 + x - 2 * y + 0.5 * z, GRID, (-9, 2, -1), (9, -4, 3), step=0.7)
    t = line.position / line.position[-1]
    expected = 3 + (-9 + 18 * t) - 2 * (2 - 6 * t) + 0.5 * (-1 + 4 * t)
    np.testing.assert_allclose(line.values, expected, atol=1e-12)
    assert np.isnan(quality.profile(x, GRID, (0, 0, 0), (30, 0, 0)).values[-1])


def test_regions_have_the_volume_of_their_shapes():
    grid = Grid.cube(60, 60.0)
    assert quality.ball(grid, (1, 2, 3), 20).sum() == pytest.approx(4 / 3 * np.pi * 20**3, rel=0.01)
    assert quality.rod(grid, (1, 2, 3), 15, 30.2).sum() == pytest.approx(np.pi * 15**2 * 30, rel=0.02)
    marked = np.argwhere(quality.ball(GRID, (5.25, 3.5, 1.0), 0.1))
    assert marked.tolist() == [[3, 19, 30]]


def test_contrast_to_noise_is_the_difference_over_the_noise_of_the_background():
    rng, grid = np.random.default_rng(3), Grid.cube(32, 32.0)
    inside, outside = quality.ball(grid, (-8, 0, 0), 6), quality.ball(grid, (8, 0, 0), 6)
    volume = 5.0 + 0.5 * rng.standard_normal(grid.shape) + 2.0 * inside
    found = quality.statistics(volume, outside)
    error = 0.5 / np.sqrt(found.voxels)
    assert found.mean == pytest.approx(5.0, abs=5 * error)
    assert found.noise == pytest.approx(0.5, abs=5 * error / np.sqrt(2))
    assert quality.contrast_to_noise(volume, inside, outside) == pytest.approx(4.0, rel=0.2)
    assert quality.contrast_to_noise(1.0 * inside, inside, outside) == np.inf


def test_white_noise_has_a_flat_spectrum_whose_level_is_its_variance_times_the_voxel_area():
    rng, grid = np.random.default_rng(4), Grid((40, 32, 32), (1.0, 0.5, 0.5), (0.0, 0.0, 0.0))
    volume = 7 + 0.3 * rng.standard_normal(grid.shape)
    frequency, power = quality.noise_power(volume, grid, (slice(0, 40), slice(0, 32), slice(0, 32)))
    level = 0.3**2 * 0.5 * 0.5
    np.testing.assert_allclose(power[2:], level, rtol=0.15)
    assert power[2:].mean() == pytest.approx(level, rel=0.03)
    assert frequency[-1] <= 1.0  # the Nyquist frequency


def test_a_gaussian_edge_has_the_width_and_transfer_of_its_blur():
    sigma, step = 0.8, 0.05
    distance = np.arange(-12, 12 + step / 2, step)
    response = ndtr(-distance / sigma)
    assert quality.edge_width(distance, response) == pytest.approx(2 * 1.2815515655 * sigma, rel=1e-3)
    frequency, transfer = quality.mtf(response, step, binned=False)
    low = frequency < 0.5
    np.testing.assert_allclose(transfer[low], np.exp(-2 * (np.pi * sigma * frequency[low]) ** 2), atol=0.001)


@pytest.mark.parametrize("binned", [True, False])
@pytest.mark.parametrize("step", [0.25, 0.5])
def test_large_steps_and_bins_do_not_lower_the_transfer(step, binned):
    sigma, part = 0.8, 100
    half = round(12 / step) * part
    fine = np.arange(-half, half) * step / part
    means = ndtr(-(fine + step / part / 2) / sigma).reshape(-1, part).mean(axis=1)
    response = means if binned else ndtr(-fine[::part] / sigma)
    frequency, transfer = quality.mtf(response, step, binned)
    low = frequency < 0.45  # where the transfer falls to 8 %
    expected = np.exp(-2 * (np.pi * sigma * frequency[low]) ** 2)
    np.testing.assert_allclose(transfer[low], expected, rtol=0.01)


def test_a_blurred_edge_through_voxels_has_the_transfer_of_its_blur():
    sigma, step, grid = 1.1, 0.25, Grid.cube(48, 48.0)
    z, y, x = np.meshgrid(*(grid.axis(axis) for axis in "zyx"), indexing="ij")
    distance = (x + 0.31 * y - 0.17 * z) / np.sqrt(1 + 0.31**2 + 0.17**2) - 0.4
    found, response = quality.edge_response(5 + 2 * ndtr(-distance / sigma), distance, 8, step)
    np.testing.assert_allclose(response, ndtr(-found / sigma), atol=0.02)
    frequency, transfer = quality.mtf(response, step)
    low = frequency < 0.35
    np.testing.assert_allclose(transfer[low], np.exp(-2 * (np.pi * sigma * frequency[low]) ** 2), atol=0.02)


@pytest.mark.wrong_types
@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: quality.ball(GRID, (0, 0, 0), -1), "radius of a region must be positive"),
        (lambda: quality.ball(GRID, (0, 0, np.nan), 1), "centre of a region"),
        (lambda: quality.edge_response(np.zeros(GRID.shape), np.zeros(GRID.shape), 2, 0.5), "bins .* have no voxel"),
        (lambda: quality.edge_response(np.zeros((2, 2, 2)), np.zeros((2, 2)), 2, 0.5), "shape of the volume"),
        (lambda: quality.statistics(np.zeros((2, 2, 2)), np.zeros((2, 2, 2), bool)), "at least two voxels, got 0"),
        (lambda: quality.statistics(np.zeros((2, 2, 2)), np.ones((2, 2, 3), bool)), "shape of the volume"),
        (lambda: quality.statistics(np.full((2, 2, 2), np.nan), np.ones((2, 2, 2), bool)), "8 of 8 values"),
        (lambda: quality.profile(np.zeros(GRID.shape), GRID, (0, 0, 0), (0, 0, 0)), "two different points"),
        (lambda: quality.profile(np.zeros((2, 2, 2)), GRID, (0, 0, 0), (1, 0, 0)), "shape of the grid"),
        (lambda: quality.noise_power(np.zeros(GRID.shape), GRID, (slice(4), slice(8), slice(9))), "must be square"),
        (lambda: quality.noise_power(np.zeros((4, 8, 8)), GRID, (slice(4), slice(8), slice(8))), "shape of the grid"),
        (lambda: quality.noise_power(np.full(GRID.shape, np.nan), GRID, (slice(4), slice(8), slice(8))), "256 of 256"),
        (lambda: quality.mtf(np.ones(3), 0.5), "4 finite values or more, got 3"),
        (lambda: quality.mtf(np.linspace(1, 0, 9), -1.0), "step of an edge response must be positive"),
    ],
)
def test_impossible_regions_are_refused_in_a_sentence(call, words):
    with pytest.raises(InputError, match=words):
        call()


def test_the_folder_is_reached_from_the_package_alone():
    code = "import recon; assert recon.quality.mtf and recon.figures.convergence"
    subprocess.run([sys.executable, "-c", code], check=True)
