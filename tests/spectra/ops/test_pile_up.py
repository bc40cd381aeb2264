"""Counts of pulses that pile up: against the formulas, against arrivals followed one by one, and back again."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.arrivals import counts_of_arrivals

from spectra.ops.pile_up import Lattice, Load, Shapes, event_counts, recorded_counts, reference

THRESHOLDS = (25.0, 50.0, 70.0)
EDGES = np.array([25.0, 30.0, 36.0, 41.0, 50.0, 55.5, 63.0, 70.0, 120.0])
STARTS = np.array([0, 4, 7, 8])
PULSES = np.array([3.0, 8.0, 6.0, 9.0, 5.0, 2.0, 4.0, 7.0]) * 1e3
KINDS = pytest.mark.parametrize("paralyzable", [False, True])


def counted(pulses, load, paralyzable, step=1.0):
    loads = Load.of(np.full(len(pulses), load), paralyzable)
    return recorded_counts(pulses, loads, Lattice.of(EDGES, THRESHOLDS, step))


@KINDS
@given(
    st.lists(st.floats(0, 1e4), min_size=8, max_size=8).filter(lambda p: sum(p) > 1),
    st.floats(1e-6, 1.0),
    st.floats(0.7, 4.0),
)
def test_counts_are_those_of_the_formulas(paralyzable, pulses, load, step):
    pulses = np.array(pulses)
    expected = reference.recorded_counts(pulses, load, paralyzable, Lattice.of(EDGES, THRESHOLDS, step))
    found = counted(pulses[None], load, paralyzable, step)[0]
    np.testing.assert_allclose(found, np.maximum(expected, 0), rtol=1e-9, atol=1e-9 * pulses.sum())


@KINDS
@pytest.mark.parametrize("load", [0.05, 0.3, 0.9])
def test_counts_are_those_of_arrivals_followed_one_by_one(load, paralyzable):
    rng, arrivals = np.random.default_rng(7), 1_000_000
    group = rng.choice(len(PULSES), arrivals, p=PULSES / PULSES.sum())
    heights = rng.uniform(EDGES[group], EDGES[group + 1])  # even within groups
    followed, error = counts_of_arrivals(heights, load, THRESHOLDS, paralyzable, rng)
    found = counted(PULSES[None], load, paralyzable)[0] / PULSES.sum()
    assert (error < 0.025 * followed).all()
    assert (np.abs(found - followed) < 4 * error).all()


@KINDS
def test_few_pulses_count_as_they_are(paralyzable):
    found = counted(PULSES[None], 1e-9, paralyzable)[0]
    np.testing.assert_allclose(found, np.add.reduceat(PULSES, STARTS[:-1]), rtol=1e-8)
    assert not counted(np.zeros((1, 8)), 0.0, paralyzable).any()


@KINDS
@pytest.mark.parametrize("load", [1e-3, 0.3, 0.9])
def test_events_are_found_again(load, paralyzable):
    events = np.add.reduceat(PULSES, STARTS[:-1])
    shape = PULSES / np.repeat(events, np.diff(STARTS))
    recorded = counted(np.tile(PULSES, (3, 1)), load, paralyzable)
    shapes = Shapes(np.stack([shape, shape]), np.array([0.0, 0.4, 1.0]), STARTS)
    lattice, loads = Lattice.of(EDGES, THRESHOLDS, 1.0), Load.of(np.full(3, load), paralyzable)
    found = event_counts(recorded, np.full(3, PULSES.sum()), loads, lattice, shapes)
    np.testing.assert_allclose(found, np.tile(events, (3, 1)), rtol=2e-4)


def test_impossible_counts_give_finite_events():
    lattice, loads = Lattice.of(EDGES, THRESHOLDS, 1.0), Load.of(np.array([0.0, 20.0, 0.5]), False)
    recorded = np.array([[0.0, 0.0, 0.0], [5e4, 1e2, 0.0], [-3.0, 10.0, 2.0]])
    shapes = Shapes(np.stack([np.repeat(1 / np.diff(STARTS), np.diff(STARTS))] * 2), np.zeros(3), STARTS)
    found = event_counts(recorded, np.array([0.0, 1e6, 12.0]), loads, lattice, shapes)
    assert np.isfinite(found).all()
    assert (found >= 0).all()
    assert not found[0].any()
