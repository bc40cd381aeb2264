"""Backproject: spread images of several bases over a grid of voxels, voxel-driven and distance-weighted."""

import numpy as np
from jaxtyping import Float

from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from recon.ops.arguments import inverse_frames, lattice_of
from recon.ops.backproject import cpu
from recon.ops.pieces import run_in_pieces
from spectra.errors import InputError

SLAB = 4  # slices per piece of work


def backproject(
    images: Float[np.ndarray, "view basis row column"],
    geometry: Geometry,
    grid: Grid,
    scales: Float[np.ndarray, " view"],
    onto: Float[np.ndarray, "basis z y x"] | None = None,
) -> Float[np.ndarray, "basis z y x"]:
    """Sum (scale / depth)^2 times the bilinearly interpolated pixel behind each voxel over all views.

    Parameters
    ----------
    images : one image per view and basis
    geometry : poses of the views; panels of at least 2 x 2 pixels
    grid : voxels to fill; a view adds nothing to voxels whose ray misses its panel
    scales : per view the depth at which the weight is one, as a fraction of the way from source to panel
    onto : result of earlier views, to which these views are added; views one by one give the same as all at once

    Returns
    -------
    volume of each basis, in the unit of the images

    Raises
    ------
    InputError
        When the panel has fewer than 2 x 2 pixels.
    """
    if min(geometry.panel.rows, geometry.panel.columns) < 2:
        raise InputError("back-projection interpolates between pixels: the panel needs at least 2 x 2 of them")
    frames = geometry.ray_frames()
    stacked = np.ascontiguousarray(np.moveaxis(images, 1, -1), dtype=np.float32)
    volume = np.zeros((*grid.shape, images.shape[1]), np.float32)
    if onto is not None:
        volume[:] = np.moveaxis(onto, 0, -1)
    views, lattice = cpu.Views(frames[:, 0], inverse_frames(frames), scales), lattice_of(grid)
    run_in_pieces(
        lambda first, last: cpu.backproject(stacked, views, lattice, first, last, volume), grid.shape[0], SLAB
    )
    return np.ascontiguousarray(np.moveaxis(volume, -1, 0))
