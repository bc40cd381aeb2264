"""Path lengths through the voxels of a map: every voxel is a box of one mixture, and a ray is cut at its faces."""

from math import floor
from typing import no_type_check

import numpy as np

from phantomgen.ops.kernel_decorators import called


@called
@no_type_check
def add_map(maps, table, row, direction, low, high, norm, lengths):
    """Add the path lengths of a ray inside a voxel map.

    Voxels are half open, so that a ray that runs inside a face belongs to exactly one of its two sides (Siddon 1985,
    doi:10.1118/1.595715, in the incremental form of Amanatides & Woo 1987).

    Parameters
    ----------
    maps : `VoxelMaps`
    table, row : primitives as `solid_table` makes them, with the ray's origin filled in, and the row of the map
    direction : from the ray's start to its end (x, y, z) [mm]
    low, high : the ray lies in the map from t = low to t = high
    norm : length of `direction` [mm]
    lengths : path lengths [mm], (material,), added to

    Returns
    -------
    length that is not empty [mm]
    """
    numbers, cells, starts, shapes, mixtures = maps
    dx, dy, dz = direction
    number = numbers[row]
    nz, ny, nx = shapes[number, 0], shapes[number, 1], shapes[number, 2]
    # Place at t = 0 and slope along each axis, in voxels from the corner of the box.
    px, py, pz = (table[row, 2] + 1.0) * 0.5 * nx, (table[row, 3] + 1.0) * 0.5 * ny, (table[row, 4] + 1.0) * 0.5 * nz
    sx = (table[row, 5] * dx + table[row, 6] * dy + table[row, 7] * dz) * 0.5 * nx
    sy = (table[row, 8] * dx + table[row, 9] * dy + table[row, 10] * dz) * 0.5 * ny
    sz = (table[row, 11] * dx + table[row, 12] * dy + table[row, 13] * dz) * 0.5 * nz
    ix = min(nx - 1, max(0, int(floor(px + low * sx))))
    iy = min(ny - 1, max(0, int(floor(py + low * sy))))
    iz = min(nz - 1, max(0, int(floor(pz + low * sz))))
    ahead_x = (ix + (sx > 0.0) - px) / sx if sx != 0.0 else np.inf
    ahead_y = (iy + (sy > 0.0) - py) / sy if sy != 0.0 else np.inf
    ahead_z = (iz + (sz > 0.0) - pz) / sz if sz != 0.0 else np.inf
    start, begin, t, covered = starts[number], low, low, 0.0
    cell = cells[start + (iz * ny + iy) * nx + ix]
    while True:
        inside = True
        if ahead_x <= ahead_y and ahead_x <= ahead_z:
            t = max(t, ahead_x)
            ix += 1 if sx > 0.0 else -1
            ahead_x = (ix + (sx > 0.0) - px) / sx
            inside = 0 <= ix < nx
        elif ahead_y <= ahead_z:
            t = max(t, ahead_y)
            iy += 1 if sy > 0.0 else -1
            ahead_y = (iy + (sy > 0.0) - py) / sy
            inside = 0 <= iy < ny
        else:
            t = max(t, ahead_z)
            iz += 1 if sz > 0.0 else -1
            ahead_z = (iz + (sz > 0.0) - pz) / sz
            inside = 0 <= iz < nz
        done = t >= high or not inside
        following = cell if done else cells[start + (iz * ny + iy) * nx + ix]
        if done or following != cell:
            part = ((high if done else t) - begin) * norm
            for m in range(lengths.size):
                lengths[m] += mixtures[cell, m] * part
                covered += mixtures[cell, m] * part
            begin, cell = t, following
        if done:
            return covered
