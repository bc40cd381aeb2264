"""Exact path lengths of rays through overlapping shapes.

A later shape overrides an earlier one where they overlap: a ray is cut where it enters or leaves a shape, and each
piece belongs to the last shape that covers it. Source or panel may lie inside a shape: a ray ends with them.
"""

import numpy as np
from jaxtyping import Float

from phantomgen.ops.mesh import mesh_intervals
from phantomgen.ops.solids import Solids

# Number of primitives; with more of them, a ray first tests the balls around them. Changes time, not results.
_MANY = 32


def trace(
    origins: Float[np.ndarray, "ray 3"],
    directions: Float[np.ndarray, "ray 3"],
    solids: Solids,
    count: int,
    background: int = -1,
) -> Float[np.ndarray, "ray material"]:
    """Path length per material of each ray ``origin + t direction``, 0 <= t <= 1 [mm].

    Parameters
    ----------
    origins, directions : start of each ray, and the vector from there to its end [mm]
    solids : the objects; a later one overrides an earlier one
    count : number of materials
    background : material outside all shapes, -1 for none

    Returns
    -------
    path lengths [mm], (ray, material)

    Raises
    ------
    InputError
        When the objects do not fit the materials.
    """
    # numba is only worth its import when rays are traced
    from phantomgen.ops.trace import cpu  # noqa: PLC0415
    from phantomgen.ops.trace.table import TracedSolids  # noqa: PLC0415

    solids = solids.checked(count, background)
    origins, directions = (np.ascontiguousarray(a, dtype=np.float64) for a in (origins, directions))
    out = np.empty((len(directions), count))
    listed, pieces = None, 0
    if solids.surfaces is not None:
        starts, ends = mesh_intervals(origins, directions, solids.surfaces)
        listed, pieces = (starts, ends), int(np.diff(starts, axis=1).max(axis=1, initial=0).sum())
    balls = solids.balls if solids.rows > _MANY else np.empty((0, 4))
    traced, scratch = TracedSolids.of(solids, background), cpu.RayScratch.of(solids.rows, pieces)
    cpu.trace_rays(traced, listed, balls, origins, directions, scratch, out)
    return out


def trace_view(
    frame: Float[np.ndarray, "4 3"],
    rows: int,
    columns: int,
    solids: Solids,
    count: int,
    background: int = -1,
) -> Float[np.ndarray, "row column material"]:
    """Path length per material of the rays through all pixels' centres [mm].

    Parameters
    ----------
    frame : source, vector from there to the centre of pixel (0, 0), column step, row step (x, y, z) [mm]
    rows, columns : size of the panel
    solids : the objects; a later one overrides an earlier one
    count : number of materials
    background : material outside all shapes, -1 for none

    Returns
    -------
    path lengths [mm], (row, column, material)

    Raises
    ------
    InputError
        When the objects do not fit the materials.
    """
    frame = np.ascontiguousarray(frame, dtype=np.float64)
    if solids.surfaces is not None or solids.voxels is not None:
        row, column = np.divmod(np.arange(rows * columns), columns)
        directions = frame[1] + column[:, None] * frame[2] + row[:, None] * frame[3]
        origins = np.broadcast_to(frame[0], directions.shape)
        return trace(origins, directions, solids, count, background).reshape(rows, columns, count)
    from phantomgen.ops.silhouette.forms import cone_bounds  # noqa: PLC0415
    from phantomgen.ops.silhouette.tiles import Tiles  # noqa: PLC0415
    from phantomgen.ops.trace.cpu import RayScratch  # noqa: PLC0415
    from phantomgen.ops.trace.table import ALONE, TracedSolids  # noqa: PLC0415
    from phantomgen.ops.trace.view import trace_pixels  # noqa: PLC0415

    solids = solids.checked(count, background)
    traced = TracedSolids.of(solids, background)
    tiles = Tiles.of(cone_bounds(frame, solids.kinds, solids.locals_), np.empty(0, np.int64), rows, columns)
    whole = bool((traced.table[:, ALONE] > 0).all() and (solids.owners == np.arange(solids.rows)).all())
    out = np.empty((rows, columns, count))
    trace_pixels(frame, traced, tiles, whole, RayScratch.of(solids.rows), np.empty(count), out)
    return out
