"""One round of random sequential addition in numba, with a hash table of cells."""

from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Int
from numba import njit

from phantomgen.ops.kernel_decorators import inlined


class BallCells(NamedTuple):
    """Hash table of the cells that hold balls.

    Parameters
    ----------
    width : of a cell [mm]
    heads : first ball of each slot, -1 for none
    following : next ball of the same slot, -1 for none
    """

    width: float
    heads: Int[np.ndarray, " slot"]
    following: Int[np.ndarray, " ball"]


@inlined
@no_type_check
def _slot(i, j, k, size):
    """Place of a cell in a table whose size is a power of two."""
    return (i * 73856093 ^ j * 19349663 ^ k * 83492791) & (size - 1)


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def fill_round(points, radii, gap, waiting, cells, centers, placed):
    """Put each waiting ball at its point if no ball that has a place is near.

    Parameters
    ----------
    points, radii : centres that the waiting balls try, and radii of all balls [mm]
    gap : least distance of two surfaces [mm]
    waiting : balls without a place, in the order in which they try
    cells : `BallCells`, written
    centers, placed : written for balls that find a place
    """
    width, heads, following = cells
    for w in range(waiting.size):
        b = waiting[w]
        x, y, z = points[w, 0], points[w, 1], points[w, 2]
        i, j, k = np.int64(np.floor(x / width)), np.int64(np.floor(y / width)), np.int64(np.floor(z / width))
        free = True
        for cell in range(27):
            a = heads[_slot(i + cell // 9 - 1, j + cell // 3 % 3 - 1, k + cell % 3 - 1, heads.size)]
            while a >= 0 and free:
                dx, dy, dz = centers[a, 0] - x, centers[a, 1] - y, centers[a, 2] - z
                apart = radii[a] + radii[b] + gap
                free = dx * dx + dy * dy + dz * dz >= apart * apart
                a = following[a]
            if not free:
                break
        if free:
            slot = _slot(i, j, k, heads.size)
            centers[b, 0], centers[b, 1], centers[b, 2] = x, y, z
            following[b], heads[slot] = heads[slot], b
            placed[b] = True
