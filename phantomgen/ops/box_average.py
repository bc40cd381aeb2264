"""Exact means over the voxels of one grid of what is constant in the voxels of another one with parallel axes."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.sparse import csr_array

from phantomgen.geometry.voxel_grid import Grid

# No unit; axes are parallel where other components are below this part of the largest: rounding of rotations.
PARALLEL = 1e-9


@dataclass(frozen=True, eq=False)
class Overlaps:
    """Overlaps of the voxels of two grids along one axis.

    Parameters
    ----------
    means : matrix (voxel of the result, voxel of the source); rows sum to 1 where there are any overlaps
    covered : part of each voxel of the result that lies in the source
    """

    means: csr_array
    covered: Float[np.ndarray, " voxel"]


def overlaps(grid: Grid, axis: int, count: int, scale: float, offset: float) -> Overlaps:
    """Compute the overlaps along an axis.

    Parameters
    ----------
    grid : the voxels of the result
    axis : index of the axis (z, y, x)
    count : number of voxels of the source along it
    scale, offset : a position p [mm] lies at scale p + offset, in voxels of the source whose faces are integers

    Returns
    -------
    the overlaps
    """
    centre = grid.origin[axis] + grid.spacing[axis] * np.arange(grid.shape[axis])
    one = scale * (centre - grid.spacing[axis] / 2) + offset
    other = scale * (centre + grid.spacing[axis] / 2) + offset
    low, high = np.minimum(one, other).clip(0, count), np.maximum(one, other).clip(0, count)
    first, last = np.floor(low).astype(int), np.ceil(high).astype(int)
    rows = np.repeat(np.arange(len(low)), last - first)
    columns = np.concatenate([np.arange(a, b) for a, b in zip(first, last, strict=True)]).astype(int)
    shares = np.minimum(columns + 1, high[rows]) - np.maximum(columns, low[rows])
    # A sliver that rounding leaves would be worth a whole voxel where nothing else is there.
    shares[shares < PARALLEL * abs(scale) * grid.spacing[axis]] = 0
    sums = np.bincount(rows, shares, minlength=len(low))
    means = csr_array((shares / np.where(sums == 0, 1, sums)[rows], (rows, columns)), shape=(len(low), count))
    return Overlaps(means, sums / (abs(scale) * grid.spacing[axis]))


def along_each_axis(weights: Sequence[csr_array], volume: Float[np.ndarray, "z y x"]) -> Float[np.ndarray, "z2 y2 x2"]:
    """Multiply a volume by a matrix along each axis.

    Parameters
    ----------
    weights : matrices (voxel of the result, voxel of the source) of z, y and x
    volume : the source

    Returns
    -------
    the result
    """
    for axis, matrix in enumerate(weights):
        moved = np.moveaxis(volume, axis, 0)
        mixed = matrix @ moved.reshape(len(moved), -1)
        volume = np.moveaxis(mixed.reshape(-1, *moved.shape[1:]), 0, axis)
    return volume


def box_average(volume: Float[np.ndarray, "z y x"], source: Grid, grid: Grid) -> Float[np.ndarray, "z2 y2 x2"]:
    """Compute the means over the voxels of a grid of a volume that is constant in each of its voxels.

    Parameters
    ----------
    volume : values on `source`
    source, grid : voxels of the volume and of the result

    Returns
    -------
    means over the whole voxels of `grid`; outside of `source` the volume is 0
    """
    if grid == source:
        return volume
    each = _each_axis(source, grid)
    return along_each_axis([csr_array(one.covered[:, None] * one.means) for one in each], volume)


def covered_part(source: Grid, grid: Grid) -> float:
    """Compute how much of a grid lies in another one.

    Parameters
    ----------
    source, grid : the grids

    Returns
    -------
    part of the volume of `grid` that lies in `source`, 0 to 1
    """
    return float(np.prod([one.covered.mean() for one in _each_axis(source, grid)]))


def _each_axis(source: Grid, grid: Grid) -> list[Overlaps]:
    """Overlaps along z, y and x."""
    return [
        overlaps(grid, axis, source.shape[axis], 1 / spacing, 0.5 - source.origin[axis] / spacing)
        for axis, spacing in enumerate(source.spacing)
    ]
