"""Voxel maps on another grid: what each of its voxels holds on average, in the part that lies in the map's box."""

import numpy as np
from jaxtyping import Float, Float32, Int32

from phantomgen.geometry.voxel_grid import Grid
from phantomgen.ops.box_average import PARALLEL, along_each_axis, overlaps
from phantomgen.ops.solids import Solids
from phantomgen.ops.voxel_maps import VoxelMaps
from spectra.threads import run_parallel

# Points per voxel and axis where the axes of a map and of the grid are not parallel: 64 points in all.
POINTS = 4


def mean_mixture(grid: Grid, solids: Solids, maps: VoxelMaps, row: int) -> Float32[np.ndarray, "material z y x"]:
    """Compute the mean mixture of a voxel map in each voxel of a grid.

    Overlaps of voxels are exact where axes are parallel, in any order and direction; else points are counted.

    Parameters
    ----------
    grid : the voxels
    solids, maps : the objects, and all voxel maps
    row : primitive that is the map

    Returns
    -------
    volume fractions, (material, z, y, x); 0 outside the map
    """
    number = int(maps.numbers[row])
    shape = maps.shapes[number]
    cells = maps.cells[maps.starts[number] :][: shape.prod()].reshape(shape)
    # From position (z, y, x) [mm] to voxel index, faces at integers.
    linear = (solids.locals_[row, ::-1, 2::-1] / 2) * shape[:, None]
    offset = (solids.locals_[row, ::-1, 3] + 1) / 2 * shape
    sources = np.abs(linear).argmax(axis=1)
    others = np.abs(linear).sum(axis=1) - np.abs(linear).max(axis=1)
    if len(set(sources.tolist())) == 3 and (others < PARALLEL * np.abs(linear).max(axis=1)).all():
        order = np.argsort(sources)  # axis of the map that runs along each axis of the grid
        scale = linear[order, np.arange(3)]
        return _by_overlap(grid, cells.transpose(order), scale, offset[order], maps.mixtures)
    return _by_points(grid, cells, linear, offset, maps.mixtures)


def _by_overlap(
    grid: Grid,
    cells: Int32[np.ndarray, "k j i"],
    scale: Float[np.ndarray, " 3"],
    offset: Float[np.ndarray, " 3"],
    mixtures: Float[np.ndarray, "mixture material"],
) -> Float32[np.ndarray, "material z y x"]:
    """Exact mean mixtures, one axis after the other."""
    weights = [overlaps(grid, axis, cells.shape[axis], scale[axis], offset[axis]).means for axis in range(3)]
    out = np.zeros((mixtures.shape[1], *grid.shape), dtype=np.float32)
    for material in np.flatnonzero(mixtures.any(axis=0)):
        out[material] = along_each_axis(weights, mixtures[:, material][cells])
    return out


def _by_points(
    grid: Grid,
    cells: Int32[np.ndarray, "k j i"],
    linear: Float[np.ndarray, "3 3"],
    offset: Float[np.ndarray, " 3"],
    mixtures: Float[np.ndarray, "mixture material"],
) -> Float32[np.ndarray, "material z y x"]:
    """Mean mixtures by a regular grid of points in each voxel."""
    # numba only where it computes
    from phantomgen.ops.voxelize_shapes.points import TurnedMap, mean_of_points  # noqa: PLC0415

    out = np.zeros((mixtures.shape[1], *grid.shape), dtype=np.float32)
    spacing, origin, turned = np.array(grid.spacing), np.array(grid.origin), TurnedMap(cells, linear, offset, mixtures)

    def layer(z: int) -> None:
        mean_of_points(turned, spacing, origin, POINTS, z, out)

    for _ in run_parallel(layer, range(grid.shape[0])):
        pass
    return out
