"""Larger and smaller, which are part of the kernels that use them."""

import numpy as np
import pytest
from numba import njit

from spectra.ops.min_max import larger, smaller


@njit(fastmath=True)
def both(a, b):
    return larger(a, b), smaller(a, b)


@pytest.mark.parametrize(
    ("a", "b"), [(1.5, -2.0), (-2.0, 1.5), (3, 4), (4, 3), (7, 7), (np.float32(0.1), np.float32(0.2))]
)
def test_they_are_those_of_python(a, b):
    assert both(a, b) == (max(a, b), min(a, b))
    assert type(both(a, b)[0]) is type(both(b, a)[1])
