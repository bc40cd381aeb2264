"""Mean mixture of a turned voxel map, in numba."""

from math import floor
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float, Int32
from numba import njit


class TurnedMap(NamedTuple):
    """Voxel map whose axes are not those of the grid.

    Parameters
    ----------
    cells : row of `mixtures` that each voxel holds
    linear, offset : from position (z, y, x) [mm] to voxel index, faces at integers
    mixtures : volume fraction of each material
    """

    cells: Int32[np.ndarray, "k j i"]
    linear: Float[np.ndarray, "3 3"]
    offset: Float[np.ndarray, " 3"]
    mixtures: Float[np.ndarray, "mixture material"]


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def mean_of_points(turned, spacing, origin, n, z, out):
    """Write one layer of mean mixtures: means over those of n x n x n points of a voxel that lie in the map.

    Parameters
    ----------
    turned : `TurnedMap`
    spacing, origin : size of a voxel, and centre of voxel 0 (z, y, x) [mm]
    n : points per voxel and axis
    z : the layer
    out : mixtures (material, z, y, x), whose layer is written
    """
    cells, linear, offset, mixtures = turned
    point, index, sums = np.empty(3), np.empty(3, np.int64), np.empty(out.shape[0])
    for y in range(out.shape[2]):
        for x in range(out.shape[3]):
            found = 0
            sums[:] = 0.0
            for i in range(n * n * n):
                point[0] = origin[0] + spacing[0] * (z + (i // (n * n) + 0.5) / n - 0.5)
                point[1] = origin[1] + spacing[1] * (y + (i // n % n + 0.5) / n - 0.5)
                point[2] = origin[2] + spacing[2] * (x + (i % n + 0.5) / n - 0.5)
                inside = True
                for a in range(3):
                    place = linear[a, 0] * point[0] + linear[a, 1] * point[1] + linear[a, 2] * point[2] + offset[a]
                    index[a] = int(floor(place))
                    inside = inside and 0 <= index[a] < cells.shape[a]
                if inside:
                    found += 1
                    cell = cells[index[0], index[1], index[2]]
                    for m in range(sums.size):
                        sums[m] += mixtures[cell, m]
            if found == 0:  # the map may still touch the voxel, beside all points: what is nearest to the middle
                for a in range(3):
                    place = linear[a, 0] * (origin[0] + spacing[0] * z) + linear[a, 1] * (origin[1] + spacing[1] * y)
                    place += linear[a, 2] * (origin[2] + spacing[2] * x) + offset[a]
                    index[a] = int(min(max(place, 0.0), cells.shape[a] - 1.0))
                for m in range(sums.size):
                    sums[m] = mixtures[cells[index[0], index[1], index[2]], m]
            for m in range(sums.size):
                out[m, z, y, x] = sums[m] / max(found, 1)
