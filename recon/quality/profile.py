"""Values of a volume along a line."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Real
from scipy import ndimage

from phantomgen.geometry.voxel_grid import Grid
from spectra.errors import InputError


@dataclass(frozen=True, eq=False)
class Profile:
    """Values along a line.

    Parameters
    ----------
    position : distance from the first point [mm]
    values : in the unit of the volume; NaN outside of the voxels' centres
    """

    position: Float[np.ndarray, " point"]
    values: Float[np.ndarray, " point"]


def profile(
    volume: Real[np.ndarray, "z y x"],
    grid: Grid,
    start: tuple[float, float, float],
    end: tuple[float, float, float],
    step: float | None = None,
) -> Profile:
    """Interpolate a volume linearly along a line.

    Parameters
    ----------
    volume : values of the voxels
    grid : the voxels
    start, end : points (x, y, z) [mm]
    step : largest distance of two values [mm]; half of the smallest voxel where left out

    Returns
    -------
    positions and values, both ends included

    Raises
    ------
    InputError
        When the volume is not one of the grid, or the points are equal.
    """
    if np.shape(volume) != grid.shape:
        raise InputError(f"the volume must have the shape of the grid, {grid.shape}, got {np.shape(volume)}")
    first, last = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    if first.shape != (3,) or last.shape != (3,) or not 0 < (length := float(np.linalg.norm(last - first))) < np.inf:
        raise InputError(f"a profile needs two different points (x, y, z) [mm], got {start!r} and {end!r}")
    wanted = min(grid.spacing) / 2 if step is None else step
    if not 0 < wanted < np.inf:
        raise InputError(f"the step of a profile must be positive [mm], got {step!r}")
    position = np.linspace(0.0, length, int(np.ceil(length / wanted - 1e-9)) + 1)
    points = first + position[:, None] / length * (last - first)
    index = ((points[:, ::-1] - grid.origin) / grid.spacing).T
    index = np.where(np.abs(index - np.rint(index)) < 1e-9, np.rint(index), index)
    values = ndimage.map_coordinates(np.asarray(volume, dtype=np.float64), index, order=1, cval=np.nan)
    return Profile(position, values)
