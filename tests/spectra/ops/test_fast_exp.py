import math
from typing import no_type_check

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numba import njit

from spectra.ops.fast_exp import fast_exp


@njit(error_model="numpy", fastmath={"reassoc", "contract", "nsz"})
@no_type_check
def all_of(x, out):
    for i in range(x.size):
        out[i] = fast_exp(x[i])


def test_fast_exp_equals_the_library_within_1e_14():
    x = np.concatenate([np.linspace(-708, 709, 20001), np.linspace(-1, 1, 2001)])
    out = np.empty_like(x)
    all_of(x, out)
    assert np.abs(out / np.exp(x) - 1).max() < 1e-14


def test_fast_exp_has_no_surprises_at_the_ends():
    x = np.array([0.0, -0.0, -708.5, -1e300, -np.inf, np.nan, 1e300, np.inf])
    out = np.empty_like(x)
    all_of(x, out)
    huge = math.exp(709)
    np.testing.assert_allclose(out, [1, 1, 0, 0, 0, np.nan, huge, huge], rtol=1e-13)
    assert out[0] == 1.0


@given(st.floats(-700, 700))
def test_fast_exp_from_python(x):
    assert math.isclose(fast_exp(x), math.exp(x), rel_tol=1e-14)
