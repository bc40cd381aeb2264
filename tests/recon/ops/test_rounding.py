"""Whole numbers next to a number, against the standard library."""

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from recon.ops.rounding import round_down, round_up

PLACES = st.floats(-(2.0**22), 2.0**22, width=32)


@given(PLACES)
def test_rounding_is_that_of_the_standard_library(x):
    assert round_down(np.float32(x)) == math.floor(x)
    assert round_up(np.float32(x)) == math.ceil(x)
