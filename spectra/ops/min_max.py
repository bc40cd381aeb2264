"""The larger and the smaller of two numbers, for kernels that reorder sums.

numba compiles the built-in `max`, `min` and `**` once in a process, with the flags of the kernel that happens to need
them first, for all that follow. What a kernel computes would then depend, in its last digits, on what was compiled
before it. These become part of each kernel, with its own flags.
"""

from typing import no_type_check

from numba import njit


@njit(inline="always")
@no_type_check
def larger(a, b):
    """Return the larger of two numbers of one type.

    Parameters
    ----------
    a, b : the numbers

    Returns
    -------
    the larger one
    """
    return a if a > b else b


@njit(inline="always")
@no_type_check
def smaller(a, b):
    """Return the smaller of two numbers of one type.

    Parameters
    ----------
    a, b : the numbers

    Returns
    -------
    the smaller one
    """
    return a if a < b else b
