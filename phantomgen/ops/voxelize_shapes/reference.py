"""Volume fractions by counting points."""

import numpy as np
from jaxtyping import Float

from phantomgen.geometry.voxel_grid import Grid
from phantomgen.ops.solids import Solids
from phantomgen.ops.trace.reference import owner_at


def fractions_by_points(
    grid: Grid,
    solids: Solids,
    count: int,
    n: int,
    background: int = -1,
) -> Float[np.ndarray, "material z y x"]:
    """Compute the part of n x n x n points of each voxel that each material owns.

    Parameters
    ----------
    grid : the voxels
    solids : the objects; a later one overrides an earlier one
    count : number of materials
    n : points per voxel and axis
    background : material outside all shapes, -1 for none

    Returns
    -------
    fractions, (material, z, y, x)
    """
    out = np.zeros((count, *grid.shape))
    offsets = (np.arange(n) + 0.5) / n - 0.5
    for voxel in np.ndindex(grid.shape):
        for offset in np.array(np.meshgrid(offsets, offsets, offsets)).reshape(3, -1).T:
            point = (np.array(grid.origin) + (np.array(voxel) + offset) * np.array(grid.spacing))[::-1]
            owner = owner_at(solids, point, background)
            if owner >= 0:
                out[(owner, *voxel)] += 1 / n**3
    return out
