"""Volume fractions by counting points."""

import numpy as np
from jaxtyping import Float, Int64

from phantomgen.grid import Grid
from phantomgen.ops.trace.reference import inside


def fractions_by_points(
    grid: Grid,
    kinds: Int64[np.ndarray, " shape"],
    locals_: Float[np.ndarray, "shape 3 4"],
    materials: Int64[np.ndarray, " shape"],
    count: int,
    n: int,
    background: int = -1,
) -> Float[np.ndarray, "material z y x"]:
    """Part of n x n x n points of each voxel that each material owns; the last shape that contains a point does."""
    out = np.zeros((count, *grid.shape))
    offsets = (np.arange(n) + 0.5) / n - 0.5
    for voxel in np.ndindex(grid.shape):
        for offset in np.array(np.meshgrid(offsets, offsets, offsets)).reshape(3, -1).T:
            point = (np.array(grid.origin) + (np.array(voxel) + offset) * np.array(grid.spacing))[::-1]
            owner = background
            for kind, m, material in zip(kinds, locals_, materials, strict=True):
                if inside(kind, m[:, :3] @ point + m[:, 3]):
                    owner = material
            if owner >= 0:
                out[(owner, *voxel)] += 1 / n**3
    return out
