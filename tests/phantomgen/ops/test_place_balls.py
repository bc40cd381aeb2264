"""Balls placed one after the other: the same as by comparing every pair, and honest about those without a place."""

import numpy as np
import pytest

from phantomgen.ops.place_balls import GROUPS, place_balls
from phantomgen.ops.place_balls.reference import place_one_by_one


def uniform(seed: int, count: int, size: float):
    def candidates(attempt: int, which: np.ndarray) -> np.ndarray:
        return np.random.default_rng((seed, attempt)).uniform(-size, size, (count, 3))[which]

    return candidates


@pytest.mark.parametrize("gap", [0.0, 0.3])
@pytest.mark.parametrize("seed", range(3))
def test_agrees_with_comparing_every_pair(seed: int, gap: float):
    radii = np.random.default_rng(seed).uniform(0.2, 1.5, 80)
    candidates = uniform(seed, 80, 8.0)
    centers, placed = place_balls(radii, candidates, gap)
    expected = place_one_by_one(radii, candidates, gap, 60, GROUPS)
    assert placed == len(expected) == 80
    np.testing.assert_array_equal(centers, [expected[b] for b in range(80)])


def test_counts_the_balls_that_found_a_place():
    centers, placed = place_balls(np.full(40, 1.0), uniform(0, 40, 1.2), 0.0)
    assert 1 < placed < 9
    assert len(centers) == 40


def test_no_balls_need_no_place():
    assert place_balls(np.empty(0), uniform(0, 0, 1.0), 0.0)[1] == 0
