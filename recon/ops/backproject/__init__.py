"""Backproject: spread images of several bases over a grid of voxels, voxel-driven and distance-weighted."""

import numpy as np
from jaxtyping import Float

from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from recon.ops.backproject import cpu
from spectra.errors import InputError
from spectra.threads import run_parallel

SLAB = 4  # slices per piece of work


def backproject(
    images: Float[np.ndarray, "view basis row column"],
    geometry: Geometry,
    grid: Grid,
    scales: Float[np.ndarray, " view"],
    onto: Float[np.ndarray, "basis z y x"] | None = None,
) -> Float[np.ndarray, "basis z y x"]:
    """Sum over views of (scale / depth)^2 times the bilinearly interpolated pixel behind each voxel.

    Parameters
    ----------
    images : one image per view and basis
    geometry : poses of the views; panels of at least 2 x 2 pixels
    grid : voxels to fill; those that a view's panel does not see get nothing from that view
    onto : what views before these gave, to be added to; views one by one give the same as all at once
    scales : per view the depth at which the weight is one, as a fraction of the way from source to panel
    """
    if min(geometry.panel.rows, geometry.panel.columns) < 2:
        raise InputError("back-projection interpolates between pixels: the panel needs at least 2 x 2 of them")
    frames = geometry.ray_frames()
    inverses = np.linalg.inv(np.stack([frames[:, 2], frames[:, 3], frames[:, 1]], axis=-1))
    stacked = np.ascontiguousarray(np.moveaxis(images, 1, -1), dtype=np.float32)
    volume = np.zeros((*grid.shape, images.shape[1]), np.float32)
    if onto is not None:
        volume[:] = np.moveaxis(onto, 0, -1)
    origin, spacing = np.array(grid.origin[::-1], float), np.array(grid.spacing[::-1], float)

    def piece(first: int) -> None:
        last = min(first + SLAB, grid.shape[0])
        cpu.backproject(stacked, frames[:, 0], inverses, scales, origin, spacing, first, last, volume)

    for _ in run_parallel(piece, range(0, grid.shape[0], SLAB)):
        pass
    return np.ascontiguousarray(np.moveaxis(volume, -1, 0))
