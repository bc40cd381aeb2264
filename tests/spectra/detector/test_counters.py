"""Counts above thresholds and between them."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from spectra.detector.counters import above_thresholds, between_thresholds, either_neighbour

COUNTS = arrays(np.int32, st.tuples(st.integers(1, 6), st.integers(1, 4)), elements=st.integers(0, 10**6))


@given(COUNTS)
def test_differences_undo_sums(between):
    above = above_thresholds(between)
    assert above.dtype == between.dtype
    assert (above[0] == between.sum(axis=0)).all()
    assert (np.diff(above, axis=0) <= 0).all()
    np.testing.assert_array_equal(between_thresholds(above), between)


def test_unsigned_counters_may_be_out_of_order():
    assert between_thresholds(np.array([3, 5], np.uint16)).tolist() == [-2, 5]


def test_a_difference_needs_both_of_its_counters():
    assert either_neighbour(np.array([False, True, False, False])).tolist() == [True, True, False, False]
    assert either_neighbour(np.array([False, False, True])).tolist() == [False, True, True]
