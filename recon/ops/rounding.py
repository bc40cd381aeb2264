"""Whole numbers next to a number, for kernels.

Numba makes `math.floor` and `math.ceil` a call of the C library, around which a loop saves all of its registers: rows
of Gaussians took 1.7 times as long.
"""

from typing import no_type_check

from numba import njit


@njit(inline="always")
@no_type_check
def round_down(x):
    """Largest integer that is not above `x`; what fits 64 bits."""
    whole = int(x)
    return whole - int(whole > x)


@njit(inline="always")
@no_type_check
def round_up(x):
    """Smallest integer that is not below `x`; what fits 64 bits."""
    whole = int(x)
    return whole + int(whole < x)
