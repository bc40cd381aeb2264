"""Volumes on coarser and finer grids: resampling, sharpening, and the box that holds the object."""

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter, maximum_filter, minimum_filter, uniform_filter

from phantomgen.geometry.voxel_grid import Grid
from recon.data.volume_edges import relative_density

# Unsharp mask of `sharpened`; both values were chosen on benchmarks/scenes/development.yaml.
SHARPENING = 2.0  # no unit; factor of the difference between a volume and the blurred volume
BLUR = 1.5  # voxels; standard deviation of the Gaussian that blurs
# no unit, over the largest value of a basis; a mean over 3 x 3 x 3 voxels below is empty; chosen by hand, not measured
EMPTY = 1e-2
DENSEST = 10.0  # no unit, over the typical density; denser voxels count as this dense; chosen by hand, not measured
MARGIN = 3  # voxels; border around what is not empty; chosen by hand, not measured

Box = tuple[slice, slice, slice]


def coarser(grid: Grid, factor: int) -> Grid:
    """Make a grid of voxels `factor` times as large that covers the same box; its last voxels may reach beyond.

    Parameters
    ----------
    grid : the fine grid
    factor : size of the voxels over that of `grid`

    Returns
    -------
    the coarse grid
    """
    shape = tuple(-(-n // factor) for n in grid.shape)
    spacing = tuple(factor * s for s in grid.spacing)
    origin = tuple(o + (factor - 1) / 2 * s for o, s in zip(grid.origin, grid.spacing, strict=True))
    return Grid(shape, spacing, origin)  # type: ignore[arg-type]


def resampled(
    volumes: Float[np.ndarray, "basis z y x"], grid: Grid, onto: Grid
) -> Float[np.ndarray, "basis new_z new_y new_x"]:
    """Interpolate volumes linearly on another grid; beyond the border the nearest voxel gives the value.

    Parameters
    ----------
    volumes : coefficients [1/mm]
    grid : grid of `volumes`
    onto : grid of the result

    Returns
    -------
    coefficients [1/mm] on `onto`
    """
    if onto == grid:
        return volumes
    out = volumes
    for i in range(3):
        centres = onto.origin[i] + onto.spacing[i] * np.arange(onto.shape[i])
        out = _along(out, (centres - grid.origin[i]) / grid.spacing[i], 1 + i)
    return out


def sharpened(volumes: Float[np.ndarray, "basis z y x"]) -> Float[np.ndarray, "basis z y x"]:
    """Sharpen the edges of volumes that come from a coarser grid.

    Unsharp masking, in which no voxel leaves the range of its neighbours: nothing overshoots and noise hardly grows.
    Iterations that start from the result need not sharpen every edge by themselves, which takes many passes where few
    rays cross it.

    Parameters
    ----------
    volumes : coefficients [1/mm]

    Returns
    -------
    coefficients with steeper edges [1/mm]
    """
    out = np.empty_like(volumes)
    for volume, sharp in zip(volumes, out, strict=True):
        steeper = volume + SHARPENING * (volume - gaussian_filter(volume, BLUR))
        np.clip(steeper, minimum_filter(volume, 3), maximum_filter(volume, 3), out=sharp)
    return out


def occupied(volumes: Float[np.ndarray, "basis z y x"]) -> Box:
    """Find the smallest box that holds all voxels that are not empty, with a margin.

    A voxel is empty where the mean over 3 x 3 x 3 voxels is below a hundredth of the largest value in every basis:
    there is nothing but noise. What is denser than `DENSEST` counts as that dense, as soft tissue has less than a
    hundredth of the attenuation of gold.

    Parameters
    ----------
    volumes : coefficients [1/mm]

    Returns
    -------
    ranges of voxels along z, y, x; all voxels if all are empty
    """
    denser = np.maximum(relative_density(volumes) / DENSEST, 1)
    something = np.any([uniform_filter(v, 3, mode="nearest") > EMPTY * (v / denser).max() for v in volumes], axis=0)
    box = []
    for axis, size in enumerate(something.shape):
        found = np.flatnonzero(something.any(axis=tuple({0, 1, 2} - {axis})))
        ends = (max(found[0] - MARGIN, 0), min(found[-1] + MARGIN + 1, size)) if len(found) else (0, size)
        box.append(slice(*map(int, ends)))
    return tuple(box)  # type: ignore[return-value]


def _along(
    volumes: Float[np.ndarray, "basis _ _ _"], place: Float[np.ndarray, " voxel"], axis: int
) -> Float[np.ndarray, "basis z y x"]:
    """Linear interpolation along one axis, at positions in voxels."""
    last = volumes.shape[axis] - 1
    place = np.clip(place, 0, last)
    low = np.minimum(place.astype(int), max(last - 1, 0))
    shape = [1] * volumes.ndim
    shape[axis] = -1
    part = (place - low).astype(volumes.dtype).reshape(shape)
    return (1 - part) * volumes.take(low, axis) + part * volumes.take(np.minimum(low + 1, last), axis)
