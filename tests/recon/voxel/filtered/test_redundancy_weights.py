"""Weights of rays that are met twice: those of both add up to 2, as on a full circle."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from recon.voxel.filtered.redundancy_weights import half_fan_weights, parker_weights

spares, parts = st.floats(0.05, 1.5), st.floats(-0.95, 0.95)


@given(spare=spares, fan=parts, where=st.floats(0, 1))
def test_the_two_views_of_a_ray_on_an_arc_share_it(spare, fan, where):
    """The ray at angle b and fan g is met again at b + pi - 2 g with the fan -g."""
    spare, fan = min(spare, 1.5), fan * min(spare, 1.5)
    first = where * max(2 * spare + 2 * fan, 0)
    both = parker_weights(np.array([first, first + np.pi - 2 * fan]), np.array([[fan], [-fan]]), spare)
    np.testing.assert_allclose(both.sum(), 2, atol=1e-6)


@given(spare=spares, fan=parts, where=st.floats(0, 1))
def test_a_ray_that_is_met_once_counts_fully(spare, fan, where):
    fan = fan * spare
    low, high = 2 * (spare + fan), np.pi + 2 * fan
    if low < high:
        np.testing.assert_allclose(parker_weights(np.array([low + where * (high - low)]), np.array([[fan]]), spare), 2)


def test_the_ends_of_an_arc_count_nothing():
    fan = np.linspace(-0.2, 0.2, 5)[None]
    ends = parker_weights(np.array([0.0, np.pi + 0.5]), np.repeat(fan, 2, axis=0), 0.25)
    np.testing.assert_allclose(ends, 0, atol=1e-12)


@given(overlap=st.floats(0.5, 30.0), distance=st.floats(50.0, 1e9), part=st.floats(-3, 3))
def test_opposite_columns_of_a_half_fan_share_a_ray(overlap, distance, part):
    weights = half_fan_weights(np.array([part, -part]) * overlap, overlap, distance)
    np.testing.assert_allclose(weights.sum(), 2, atol=1e-9)
    assert weights.min() >= 0
