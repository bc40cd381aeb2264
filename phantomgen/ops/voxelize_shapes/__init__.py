"""Volume fraction of each material in each voxel of a grid."""

import numpy as np
from jaxtyping import Float, Float32

from phantomgen.geometry.voxel_grid import Grid
from phantomgen.ops.mesh import mesh_view
from phantomgen.ops.solids import Solids
from phantomgen.ops.voxel_maps import VoxelMaps
from phantomgen.ops.voxelize_shapes.resample import mean_mixture
from spectra.threads import run_parallel, thread_count

# Gauss nodes across and along a silhouette: of the rule, and of a weaker one that must agree with it; errors in
# `benchmarks/operators/volume_fractions.py`.
RULES = ((4, 4), (3, 3))
# Pieces of work per thread; changes time, not results.
_PIECES = 8


def fractions(
    grid: Grid,
    solids: Solids,
    count: int,
    background: int = -1,
) -> Float32[np.ndarray, "material z y x"]:
    """Compute the part of each voxel's volume that each material fills.

    Exact along z. Across (y, x), columns that a silhouette or a sloped surface passes are averaged over Gauss nodes,
    split along the silhouettes and refined until they agree: cylinders and boxes along z come out to rounding, other
    solids to some 1e-4 of a voxel (`benchmarks/operators/volume_fractions.py`), and far better in sums.

    Parameters
    ----------
    grid : the voxels
    solids : the objects; a later one overrides an earlier one. Of a voxel map that shares a voxel with other objects,
        a voxel gets its mean mixture there.
    count : number of materials
    background : material outside all shapes, -1 for none

    Returns
    -------
    fractions, (material, z, y, x)

    Raises
    ------
    InputError
        When the objects do not fit the materials.
    """
    from phantomgen.ops.silhouette import forms, quadrature, tiles  # noqa: PLC0415 - numba only where it computes
    from phantomgen.ops.trace.cpu import RayScratch  # noqa: PLC0415
    from phantomgen.ops.trace.table import MATERIAL, TracedSolids  # noqa: PLC0415
    from phantomgen.ops.voxelize_shapes.cpu import Columns, ColumnScratch, voxelize_rows  # noqa: PLC0415

    solids = solids.checked(count, background)
    frame = column_frame(grid)
    outline = forms.parallel_silhouettes(frame, solids.kinds, solids.locals_)
    rules = quadrature.make_rules(*RULES)
    depth, rows, columns = grid.shape
    near = tiles.Tiles.of(outline.bounds, outline.shapes, rows, columns)
    # Each map is a material of its own until the end.
    maps = None if solids.voxels is None else solids.voxels.numbers
    kinds = count if maps is None else count + int(maps.max()) + 1
    out = np.empty((kinds, depth, rows, columns), dtype=np.float32)

    seen = None
    if solids.surfaces is not None:
        seen = mesh_view(frame, rows, columns, solids.surfaces, parallel=True, with_outline=False)

    traced = TracedSolids.of(solids, background)
    if maps is not None:
        traced.table[maps >= 0, MATERIAL] = count + maps[maps >= 0]
        traced = traced._replace(maps=None)  # boxes of materials of their own

    # Some rows at a time, as a call of the kernel takes as long as a few columns.
    step = max(1, rows // (_PIECES * thread_count()))

    def voxelize(first: int) -> None:
        mesh, pieces = (None, 0) if seen is None else (seen.traced(), seen.pieces)
        part = np.empty((kinds, depth, min(step, rows - first), columns), dtype=np.float32)
        own = traced._replace(table=traced.table.copy())  # where this thread writes the origins of lines
        scratch = ColumnScratch.of(rules, RayScratch.of(solids.rows, pieces), kinds, depth)
        voxelize_rows(Columns(frame, own, mesh, near, outline, rules), scratch, first, part)
        out[:, :, first : first + step] = part

    for _ in run_parallel(voxelize, range(0, rows, step)):
        pass
    return out if solids.voxels is None else _with_contents(grid, solids, solids.voxels, out, count, background)


def _with_contents(
    grid: Grid, solids: Solids, maps: VoxelMaps, filled: Float32[np.ndarray, "kind z y x"], count: int, background: int
) -> Float32[np.ndarray, "material z y x"]:
    """Fractions of materials, with the contents of each map in place of its box; empty voxels are background."""
    out = filled[:count]
    for row in np.flatnonzero(maps.numbers >= 0).tolist():
        share = filled[count + maps.numbers[row]]
        contents = share * mean_mixture(grid, solids, maps, int(row))
        out += contents
        if background >= 0:
            out[background] += share - contents.sum(axis=0)
    return out.clip(0, 1)


def column_frame(grid: Grid) -> Float[np.ndarray, "4 3"]:
    """Return the parallel rays along z through the columns of a grid.

    Parameters
    ----------
    grid : the voxels

    Returns
    -------
    line along z through the grid, foot of the line through column (0, 0), steps along x and y (x, y, z) [mm]
    """
    (nz, _, _), (dz, dy, dx), (z, y, x) = grid.shape, grid.spacing, grid.origin
    return np.array([[0.0, 0.0, nz * dz], [x, y, z - dz / 2], [dx, 0.0, 0.0], [0.0, dy, 0.0]])
