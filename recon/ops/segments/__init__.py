"""Line integrals of voxel volumes along segments between any two points."""

import numpy as np
from jaxtyping import Float

from phantomgen.geometry.voxel_grid import Grid
from recon.ops.segments.cpu import add_line_integrals

# voxels; largest distance of samples along a segment; the error is measured in tests/recon/ops/test_segments.py
STEP = 0.5


def segment_integrals(
    starts: Float[np.ndarray, "segment 3"],
    ends: Float[np.ndarray, "segment 3"],
    volumes: Float[np.ndarray, "basis z y x"],
    grid: Grid,
) -> Float[np.ndarray, "segment basis"]:
    """Compute line integrals of linearly interpolated volumes, which are 0 beyond their outer voxels.

    Parameters
    ----------
    starts, ends : of the segments, (x, y, z) [mm]
    volumes : coefficients [1/mm]
    grid : their voxels

    Returns
    -------
    line integrals [no unit], by the midpoint rule
    """
    out = np.zeros((len(starts), len(volumes)))
    spacing, origin = np.array(grid.spacing[::-1]), np.array(grid.origin[::-1])
    first, last = ((np.asarray(p, np.float64) - origin) / spacing for p in (starts, ends))
    lengths = np.linalg.norm(np.subtract(ends, starts), axis=1)
    # voxels in order (z, y, x, basis), so that all bases of a voxel lie side by side
    add_line_integrals(first, last, lengths, np.ascontiguousarray(np.moveaxis(volumes, 0, -1), np.float64), STEP, out)
    return out
