"""Volume fraction of each material in each voxel of a grid."""

from collections.abc import Iterator
from types import ModuleType

import numpy as np
from jaxtyping import Bool, Float, Float32

from phantomgen.geometry.voxel_grid import Grid
from phantomgen.ops.mesh import mesh_view
from phantomgen.ops.primitives import BOX, CYLINDER, TORUS
from phantomgen.ops.solids import Solids
from phantomgen.ops.voxel_maps import VoxelMaps
from phantomgen.ops.voxelize_shapes.resample import mean_mixture
from spectra.threads import run_parallel, thread_count

# Gauss nodes across and along a silhouette: of the rule, and of a weaker one that must agree with it; errors in
# `benchmarks/operators/volume_fractions.py`.
RULES = ((4, 4), (3, 3))
# Scenes of more primitives are computed layer by layer: a line through one layer meets few of them, and the curves
# where walls cut its faces are known. Columns of few primitives are as fast whole, and exact to more digits in sums.
CROWDED = 100
# No unit; an axis closer to z than this is upright, far above rounding.
_UPRIGHT = 1e-12
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
    rules = quadrature.make_rules(*RULES)
    depth, rows, columns = grid.shape
    # Each map is a material of its own until the end.
    maps = None if solids.voxels is None else solids.voxels.numbers
    kinds = count if maps is None else count + int(maps.max()) + 1
    out = np.empty((kinds, depth, rows, columns), dtype=np.float32)
    traced = TracedSolids.of(solids, background)
    if maps is not None:
        traced.table[maps >= 0, MATERIAL] = count + maps[maps >= 0]
        traced = traced._replace(maps=None)  # boxes of materials of their own

    # Some rows at a time, as a call of the kernel takes as long as a few columns.
    step = max(1, rows // (_PIECES * thread_count()))
    heights = _heights(solids, forms)
    crowded = solids.rows > CROWDED and solids.surfaces is None
    for low, high in _slabs(grid, solids, heights) if crowded else [(0, depth)]:
        slab = _slab(grid, low, high)
        frame = column_frame(slab)
        curves = forms.layer_curves if crowded and high - low == 1 else forms.parallel_silhouettes
        outline = curves(frame, solids.kinds, solids.locals_)
        if crowded:
            outline = outline._replace(bounds=_term_bounds(solids, frame, heights, forms))
        near = tiles.Tiles.of(outline.bounds, outline.shapes, rows, columns)
        seen = None
        if solids.surfaces is not None:
            seen = mesh_view(frame, rows, columns, solids.surfaces, parallel=True, with_outline=False)

        def voxelize(
            first: int, low=low, frame=frame, outline=outline, near=near, seen=seen, layers=slab.shape[0]
        ) -> None:
            mesh, pieces = (None, 0) if seen is None else (seen.traced(), seen.pieces)
            part = np.empty((kinds, layers, min(step, rows - first), columns), dtype=np.float32)
            own = traced._replace(table=traced.table.copy())  # where this thread writes the origins of lines
            scratch = ColumnScratch.of(rules, RayScratch.of(solids.rows, pieces), kinds, layers)
            voxelize_rows(Columns(frame, own, mesh, near, outline, rules), scratch, first, part)
            out[:, low : low + layers, first : first + step] = part

        for _ in run_parallel(voxelize, range(0, rows, step)):
            pass
    return out if solids.voxels is None else _with_contents(grid, solids, solids.voxels, out, count, background)


def _slabs(grid: Grid, solids: Solids, heights: Float[np.ndarray, "shape 2"]) -> Iterator[tuple[int, int]]:
    """First layer, and the one after the last, of parts of a grid that are computed together.

    They are single layers, in which a line meets few shapes, and in which the kinks of sloped surfaces are known
    curves. Where all walls are upright, as many layers as possible are one part. So are the layers of a torus, whose
    curves are no conics and which is averaged more finely then.
    """
    depth = grid.shape[0]
    single = _reached(grid, heights[~_are_upright(solids)])
    torus = _reached(grid, heights[solids.kinds == TORUS])
    low = 0
    while low < depth:
        high = low + 1
        while high < depth and torus[low] == torus[high] and (torus[low] or not (single[low] or single[high])):
            high += 1
        yield low, high
        low = high


def _reached(grid: Grid, heights: Float[np.ndarray, "some 2"]) -> Bool[np.ndarray, " layer"]:
    """Layers that some shapes reach into."""
    depth = grid.shape[0]
    faces = grid.origin[0] + (np.arange(depth + 1) - 0.5) * grid.spacing[0]
    first = np.clip(np.searchsorted(faces, heights[:, 0], side="right") - 1, 0, depth)
    last = np.clip(np.searchsorted(faces, heights[:, 1], side="left"), 0, depth)
    change = np.zeros(depth + 1, np.int64)
    np.add.at(change, first, 1)
    np.add.at(change, np.maximum(first, last), -1)
    return np.cumsum(change)[:depth] > 0


def _are_upright(solids: Solids) -> Bool[np.ndarray, " row"]:
    """Whether all walls of a shape are parallel to z: those of cylinders along z and of boxes turned about z only."""
    local = np.abs(solids.locals_[:, :, :3])
    size = local.max(axis=(1, 2), initial=0.0)
    along = local[:, 2, :2].max(axis=1) <= _UPRIGHT * size  # local z does not change across
    across = local[:, :2, 2].max(axis=1) <= _UPRIGHT * size  # local x and y do not change along z
    return np.isin(solids.kinds, (CYLINDER, BOX)) & along & across


def _slab(grid: Grid, low: int, high: int) -> Grid:
    """Some layers of a grid."""
    z, y, x = grid.origin
    return Grid((high - low, *grid.shape[1:]), grid.spacing, (z + low * grid.spacing[0], y, x))


def _heights(solids: Solids, forms: ModuleType) -> Float[np.ndarray, "shape 2"]:
    """Lowest and highest z of each shape [mm]."""
    along_x = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    return forms.parallel_bounds(along_x, solids.kinds, solids.locals_, solids.tubes)[:, 2:]


def _term_bounds(
    solids: Solids, frame: Float[np.ndarray, "4 3"], heights: Float[np.ndarray, "shape 2"], forms: ModuleType
) -> Float[np.ndarray, "shape 4"]:
    """Bounds of the shapes within columns; none of shapes whose term lies above or below these, or nowhere."""
    low, high = frame[1, 2], frame[1, 2] + frame[0, 2]
    own = forms.parallel_bounds(frame, solids.kinds, solids.locals_, solids.tubes)
    found = solids.term_bounds(np.column_stack([own, heights]))
    missed = (found[:, 4] >= high) | (found[:, 5] <= low)
    return np.where(missed[:, None], np.array([np.inf, -np.inf, np.inf, -np.inf]), found[:, :4])


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
