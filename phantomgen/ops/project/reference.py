"""Voxel projector by its definition: the whole matrix of one view, in float64, one ray after the other."""

from itertools import product

import numpy as np
from jaxtyping import Float

from phantomgen.geometry.voxel_grid import Grid


def matrix_of_view(
    frame: Float[np.ndarray, "4 3"], rows: int, columns: int, grid: Grid, parallel: bool = False
) -> Float[np.ndarray, "ray voxel"]:
    """Compute the weights of all voxels in each line integral.

    A ray is cut by layers of voxels across its main axis. There a pixel's beam is a rectangle, at least a voxel wide; a
    voxel's weight is its part of the rectangle times the length of the ray in the layer.

    Parameters
    ----------
    frame, rows, columns, grid, parallel : as in `phantomgen.ops.project.project`, of one view

    Returns
    -------
    weights [mm], (ray, voxel)
    """
    spacing, origin = np.array(grid.spacing), np.array(grid.origin)
    matrix = np.zeros((rows, columns, *grid.shape))
    for row, column in np.ndindex(rows, columns):
        point, steps = frame[1] + column * frame[2] + row * frame[3], frame[2:, ::-1] / spacing
        begin, way = (point, frame[0]) if parallel else (frame[0], point)
        start, ray = (begin[::-1] - origin) / spacing, way[::-1] / spacing
        axis = int(np.abs(ray).argmax())
        shadow = steps - steps[:, axis : axis + 1] * ray / ray[axis]
        for k in range(grid.shape[axis]):
            ends = np.sort((k + np.array([-0.5, 0.5]) - start[axis]) / ray[axis]).clip(0, 1)
            middle = start + ends.mean() * ray
            width = np.maximum(1.0, np.linalg.norm(shadow, axis=0) * (1.0 if parallel else ends.mean()))
            parts = [_part(middle[i], width[i], grid.shape[i]) for i in range(3)]
            parts[axis] = (np.arange(grid.shape[axis]) == k) * (ends[1] - ends[0])
            for z, y, x in product(*(np.flatnonzero(part) for part in parts)):
                matrix[row, column, z, y, x] += parts[0][z] * parts[1][y] * parts[2][x] * np.linalg.norm(way)
    return matrix.reshape(rows * columns, -1)


def _part(centre: float, width: float, count: int) -> Float[np.ndarray, " voxel"]:
    """Part of the beam ``centre +- width / 2`` in each voxel."""
    voxels = np.arange(count)
    overlap = np.minimum(centre + width / 2, voxels + 0.5) - np.maximum(centre - width / 2, voxels - 0.5)
    return np.maximum(overlap, 0) / width
