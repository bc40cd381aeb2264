"""Grids of rays that plans are judged by: they become finer where their own error would decide, and only there."""

import numpy as np
import pytest

from phantomgen.simulation.checks.reference_rays import RAYS, RayGrid, split_grid

PIXELS = np.array([[0, 0], [0, 1]])
LEVEL = np.ones(1)
# A grid of the most rays errs by half a ray's share of the jump, here relative to the lowest average below.
BOUND = 0.8 / 0.44 / (2 * 2048)


def half_plane(edge):
    """Counts of a pixel, 1 left of an edge and 0.2 right of it, by rays in columns; and what was asked for."""
    asked = []

    def counts_of(pixels, rays):
        asked.append(rays)
        places = (np.arange(rays) + 0.5) / rays
        return np.full((len(pixels), 1), np.where(places < edge, 1.0, 0.2).mean())

    return counts_of, asked


@pytest.mark.parametrize("edge", [0.30119, 0.4019])
def test_a_coarse_grid_does_not_condemn_exact_counts(edge):
    counts_of, asked = half_plane(edge)
    exact = np.full((1, 1, 2), edge + 0.2 * (1 - edge))
    coarse = RayGrid(PIXELS, counts_of).worst(exact, np.array([True, False]), LEVEL, np.inf)
    fine = RayGrid(PIXELS, counts_of).worst(exact, np.array([True, False]), LEVEL, 1e-5)
    assert coarse > BOUND
    assert fine <= BOUND
    assert max(asked) == 2048


def test_wrong_counts_are_told_without_more_rays():
    counts_of, asked = half_plane(0.30119)
    wrong = np.full((1, 1, 2), 1.1 * (0.30119 + 0.2 * (1 - 0.30119)))
    error = RayGrid(PIXELS, counts_of).worst(wrong, np.array([True, True]), LEVEL, 1e-6)
    assert error == pytest.approx(np.log(1.1), rel=0.02)
    assert max(asked) == RAYS


def test_good_counts_take_one_grid_per_chosen_pixel():
    counts_of, asked = half_plane(0.25)
    grid = RayGrid(PIXELS, counts_of)
    assert grid.worst(np.full((1, 1, 2), 0.4), np.array([True, False]), LEVEL, 1e-3) < 1e-12
    assert grid.worst(np.full((1, 1, 2), 0.4), np.array([True, False]), LEVEL, 1e-3) < 1e-12
    assert asked == [RAYS]


def test_parts_of_a_large_grid_make_up_the_whole():
    frame = np.array([[0.0, 0, 0], [0, 0, 10], [1, 0, 0], [0, 1, 0]])
    across, down = set(), set()

    def expected_counts(shifted, aperture, rays):
        places = (np.arange(rays) + 0.5) / rays - 0.5
        across.update((shifted[1, 0] + aperture[0] * places).round(12))
        down.update((shifted[1, 1] + aperture[1] * places).round(12))
        return np.array([[shifted[1, 0] > 0, shifted[1, 1] > 0]], dtype=float)

    assert split_grid(expected_counts, frame, (0.8, 0.5), 2048).tolist() == [[0.5, 0.5]]
    wanted = (np.arange(2048) + 0.5) / 2048 - 0.5
    np.testing.assert_allclose(sorted(across), 0.8 * wanted, atol=1e-11)
    np.testing.assert_allclose(sorted(down), 0.5 * wanted, atol=1e-11)
