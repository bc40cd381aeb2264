"""Rays through closed triangle meshes.

A view, a source with a panel or parallel lines with their feet on a plane, is a projective grid: vertices are projected
once, each cell of the grid (a pixel, a voxel column) lists the triangles that rays through it may meet, and a rule that
gives each edge to exactly one side (`phantomgen.ops.mesh.cpu`) finds an even number of crossings on every line, through
vertices and along faces too. Surfaces must be closed and must not cross themselves; `phantomgen.shapes.mesh` checks.
"""

from collections.abc import Iterable
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int32, Int64, UInt8

from phantomgen.ops.mesh.edges import CREASE, PLAIN, SILHOUETTE, closed_edges, sharp_edges
from spectra.errors import InputError

__all__ = [
    "CREASE",
    "PLAIN",
    "SILHOUETTE",
    "MeshView",
    "Surfaces",
    "enclosures",
    "mesh_crossings",
    "mesh_lengths",
    "mesh_view",
]


class Surfaces(NamedTuple):
    """Closed meshes, one after the other; within each, what is close in space is close in memory.

    Parameters
    ----------
    vertices : corners of all meshes (x, y, z) [mm]
    triangles : indices of vertices, counter-clockwise seen from outside
    parts : mesh m owns the triangles ``parts[m]`` to ``parts[m + 1]``
    edges : both ends and both triangles of each edge
    sharp : whether an edge is a crease
    """

    vertices: Float[np.ndarray, "vertex 3"]
    triangles: Int32[np.ndarray, "triangle 3"]
    parts: Int64[np.ndarray, " boundary"]
    edges: Int32[np.ndarray, "edge 4"]
    sharp: Bool[np.ndarray, " edge"]

    @classmethod
    def of(cls, meshes: Iterable[tuple[np.ndarray, np.ndarray]]) -> "Surfaces":
        """Surfaces of (vertices, triangles) pairs that are closed: two triangles meet at every edge."""
        pairs = [_ordered(*_checked(vertices, triangles)) for vertices, triangles in meshes]
        edges = [closed_edges(triangles) for _, triangles in pairs]
        sharp = [sharp_edges(*pair, found) for pair, found in zip(pairs, edges, strict=True)]
        corners = np.cumsum([0, *(len(vertices) for vertices, _ in pairs)])
        parts = np.cumsum([0, *(len(triangles) for _, triangles in pairs)])
        shifts = [np.array([c, c, t, t], dtype=np.int32) for c, t in zip(corners[:-1], parts[:-1], strict=True)]
        return cls(
            vertices=np.concatenate([np.empty((0, 3)), *(vertices for vertices, _ in pairs)]),
            triangles=np.concatenate(
                [np.empty((0, 3), np.int32), *(t + np.int32(c) for (_, t), c in zip(pairs, corners[:-1], strict=True))]
            ),
            parts=parts.astype(np.int64),
            edges=np.concatenate(
                [np.empty((0, 4), np.int32), *(e + shift for e, shift in zip(edges, shifts, strict=True))]
            ),
            sharp=np.concatenate([np.empty(0, np.bool_), *sharp]),
        )


class MeshView(NamedTuple):
    """What the rays of one view need to know about meshes; arguments of `phantomgen.ops.mesh.cpu.intervals`.

    Parameters
    ----------
    corners : homogeneous coordinates of each vertex
    triangles : indices of vertices
    starts : rays in cell ``row * columns + column`` may meet the triangles of mesh m that stand in
        ``candidates[starts[m, cell] : starts[m, cell + 1]]``
    candidates : indices of triangles, ascending in each cell
    room : longest of these lists plus one: the scratch that a ray needs for one mesh
    outline : PLAIN, CREASE or SILHOUETTE per pixel
    """

    corners: Float[np.ndarray, "vertex 4"]
    triangles: Int32[np.ndarray, "triangle 3"]
    starts: Int64[np.ndarray, "mesh boundary"]
    candidates: Int32[np.ndarray, " entry"]
    room: int
    outline: UInt8[np.ndarray, "row column"]


def mesh_view(
    frame: Float[np.ndarray, "4 3"],
    rows: int,
    columns: int,
    surfaces: Surfaces,
    parallel: bool = False,
    cells: tuple[float, float, float, float] = (-0.5, -0.5, 1.0, 1.0),
    with_outline: bool = True,
) -> MeshView:
    """Project meshes to one view, and list per cell which triangles its rays may meet.

    Parameters
    ----------
    frame : of rays ``frame[0] + t (frame[1] + u frame[2] + v frame[3])``, as `Geometry.ray_frames` gives them [mm];
        if `parallel`, of rays ``frame[1] + u frame[2] + v frame[3] + t frame[0]``; 0 <= t <= 1
    rows, columns : size of the panel in cells
    surfaces : the meshes
    parallel : which of the two
    cells : u and v where the first cell begins, and its width and height in u and v; pixels unless given
    with_outline : whether to look for creases and silhouettes, too
    """
    from phantomgen.ops.mesh import cpu  # noqa: PLC0415 - numba is only worth its import when there are meshes

    frame, grid = np.ascontiguousarray(frame, dtype=np.float64), np.array(cells, dtype=np.float64)
    matrix, offset = _projection(frame, parallel)
    vertices, triangles, parts, edges, sharp = surfaces
    corners, places = np.empty((len(vertices), 4)), np.empty((len(vertices), 2))
    cpu.project(vertices, matrix, offset, bool(parallel), grid, corners, places)
    starts = np.zeros((len(parts) - 1, rows * columns + 1), dtype=np.int64)
    none = np.empty(0, dtype=np.int32)
    for m, (begin, end) in enumerate(pairwise(parts)):
        cpu.bin_triangles(corners, places, triangles, begin, end, grid, columns, starts[m, 1:], none, False)
    room = int(starts.max(initial=0)) + 1
    flat = starts.reshape(-1)
    np.cumsum(flat, out=flat)
    candidates = np.empty(flat[-1] if flat.size else 0, dtype=np.int32)
    for m, (begin, end) in enumerate(pairwise(parts)):
        next_entry = starts[m, :-1].copy()
        cpu.bin_triangles(corners, places, triangles, begin, end, grid, columns, next_entry, candidates, True)
    outline = np.zeros((rows, columns), dtype=np.uint8)
    if with_outline:
        from phantomgen.ops.mesh.outline import mark_outline  # noqa: PLC0415

        mark_outline(corners, triangles, edges, sharp, grid, np.empty(len(triangles), np.bool_), outline)
    return MeshView(corners, triangles, starts, candidates, room, outline)


def mesh_lengths(
    frame: Float[np.ndarray, "4 3"],
    uv: Float[np.ndarray, "ray 2"],
    vertices: Float[np.ndarray, "vertex 3"],
    triangles: Int64[np.ndarray, "triangle 3"],
    parallel: bool = False,
) -> Float[np.ndarray, " ray"]:
    """Length inside a closed mesh of each ray (u, v) of a view [mm]; source and panel may lie inside.

    Parameters
    ----------
    frame, parallel : the rays, as in `mesh_view`
    uv : column and row where each ray meets the panel, not necessarily on it [pixel]
    vertices, triangles : the mesh [mm]
    """
    from phantomgen.ops.mesh.cpu import ray_lengths  # noqa: PLC0415

    uv, view, at = _cells_of_rays(frame, uv, vertices, triangles, parallel)
    directions = frame[0] if parallel else frame[1] + uv @ frame[2:]
    norms = np.broadcast_to(np.linalg.norm(directions, axis=-1), len(uv))
    out = np.empty(len(uv))
    ray_lengths(*view[:2], view.starts[0], view.candidates, uv, norms, at, np.empty(view.room), out)
    return out


def mesh_crossings(
    frame: Float[np.ndarray, "4 3"],
    uv: Float[np.ndarray, "ray 2"],
    vertices: Float[np.ndarray, "vertex 3"],
    triangles: Int64[np.ndarray, "triangle 3"],
    parallel: bool = False,
) -> tuple[Int64[np.ndarray, " boundary"], Float[np.ndarray, " crossing"]]:
    """All places t > 0, ascending, where each ray (u, v) crosses a closed mesh, also beyond the panel (t > 1).

    Returns
    -------
    starts, places : ray i crosses at ``places[starts[i] : starts[i + 1]]``: an even number of times, an odd number if
        it begins inside. Parameters are those of `mesh_lengths`.
    """
    from phantomgen.ops.mesh.cpu import ray_crossings  # noqa: PLC0415

    uv, view, at = _cells_of_rays(frame, uv, vertices, triangles, parallel)
    counts, found = np.empty(len(uv), dtype=np.int64), np.empty(view.room)
    lists = (*view[:2], view.starts[0], view.candidates)
    ray_crossings(*lists, uv, at, found, counts, found, False)
    starts = np.concatenate([[0], np.cumsum(counts)])
    places = np.empty(starts[-1])
    ray_crossings(*lists, uv, at, found, counts, places, True)
    return starts, places


def enclosures(
    points: Float[np.ndarray, "point 3"],
    vertices: Float[np.ndarray, "vertex 3"],
    triangles: Int64[np.ndarray, "triangle 3"],
    labels: Int64[np.ndarray, " triangle"] | None = None,
    own: Int64[np.ndarray, " point"] | None = None,
) -> Int64[np.ndarray, " point"]:
    """Number of crossings above each point (x, y, z) [mm], on a line along z: odd for points inside.

    Parameters
    ----------
    points, vertices, triangles : what is asked for; the mesh [mm]
    labels, own : each point does not see the triangles whose label is its own
    """
    from phantomgen.ops.mesh.cpu import count_beyond  # noqa: PLC0415

    if labels is None or own is None:
        labels, own = np.zeros(len(triangles), np.int64), np.ones(len(points), np.int64)
    x, y, z = np.eye(3)
    points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    uv, view, at = _cells_of_rays(np.stack([z, 0 * z, x, y]), points[:, :2], vertices, triangles, True)
    depths, out = np.ascontiguousarray(points[:, 2]), np.empty(len(points), np.int64)
    count_beyond(*view[:2], view.starts[0], view.candidates, uv, at, depths, labels, own, out)
    return out


def overlaps(
    vertices: Float[np.ndarray, "vertex 3"], triangles: Int64[np.ndarray, "triangle 3"], lines: int = 128
) -> Bool[np.ndarray, " triangle"]:
    """Which faces begin or end a piece of a line that is inside of a body and inside or outside of another one, too.

    Parameters
    ----------
    vertices, triangles : a closed mesh whose neighbours agree about which side is outside [mm]
    lines : across the mesh in both directions, all in a direction that faces seldom have
    """
    from phantomgen.ops.mesh.cpu import mark_overlaps  # noqa: PLC0415

    axes = np.linalg.qr([[0.3, 0.5, 0.81], [0.47, -0.8, 0.33], [0.7, 0.2, -0.6]])[0]
    axes[2] *= np.linalg.det(axes)
    middle = vertices.min(axis=0) / 2 + vertices.max(axis=0) / 2
    places = (vertices - middle) @ axes.T
    low, high = places.min(axis=0), places.max(axis=0)
    part = (np.arange(lines) + 0.5) / lines
    uv = np.stack(np.meshgrid(*(low[:2] + part[:, None] * (high - low)[:2]).T), axis=-1).reshape(-1, 2)
    frame = np.stack([axes[2], middle, axes[0], axes[1]])
    uv, view, at = _cells_of_rays(frame, uv, vertices, triangles, True)
    scratch = np.empty(view.room), np.empty(view.room, np.int64), np.empty(view.room, np.bool_)
    out = np.zeros(len(triangles), np.bool_)
    least = 1e-9 * float(np.linalg.norm(high - low))
    mark_overlaps(*view[:2], view.starts[0], view.candidates, uv, at, *scratch, least, out)
    return out


def _checked(vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    vertices = np.ascontiguousarray(vertices, dtype=np.float64)
    triangles = np.ascontiguousarray(triangles, dtype=np.int32)
    if vertices.ndim != 2 or vertices.shape[1] != 3 or triangles.ndim != 2 or triangles.shape[1] != 3:
        raise InputError(
            f"a mesh needs vertices (vertex, 3) and triangles (triangle, 3), got {vertices.shape} and {triangles.shape}"
        )
    if triangles.size and (triangles.min() < 0 or triangles.max() >= len(vertices)):
        raise InputError(
            f"triangles must name vertices 0..{len(vertices) - 1}, got {triangles.min()}..{triangles.max()}"
        )
    if not np.isfinite(vertices).all():
        raise InputError(f"mesh vertices must be finite, {(~np.isfinite(vertices)).any(axis=1).sum()} are not")
    return vertices, triangles


def _ordered(vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same mesh with vertices and triangles along a Z-order curve; a shuffled one takes five times as long."""
    low = vertices.min(axis=0, initial=np.inf)
    reach = (vertices - low).max(initial=0) or 1.0
    cells = ((vertices - low) * (1023 / reach)).astype(np.int64)
    code = np.zeros(len(vertices), dtype=np.int64)
    for bit in range(10):
        for axis in range(3):
            code |= ((cells[:, axis] >> bit) & 1) << (3 * bit + axis)
    order = np.argsort(code, kind="stable")
    rank = np.empty(len(order), dtype=np.int32)
    rank[order] = np.arange(len(order), dtype=np.int32)
    triangles = rank[triangles]
    return vertices[order], triangles[np.argsort(triangles.min(axis=1), kind="stable")]


def _projection(frame: np.ndarray, parallel: bool) -> tuple[np.ndarray, np.ndarray]:
    """Rows that give depth, a and b of a point relative to the origin that comes second."""
    if frame.shape != (4, 3) or not np.isfinite(frame).all():
        raise InputError(f"a frame must be four finite vectors, (4, 3), got {frame.shape}")
    axes = np.concatenate([frame[:1], frame[2:]]) if parallel else frame[1:]
    if np.linalg.matrix_rank(axes) < 3:
        raise InputError("rays of a view must not lie in one plane: the last three vectors of its frame do")
    return np.linalg.inv(axes.T), frame[1] if parallel else frame[0]


def _cells_of_rays(
    frame: np.ndarray, uv: np.ndarray, vertices: np.ndarray, triangles: np.ndarray, parallel: bool
) -> tuple[np.ndarray, MeshView, np.ndarray]:
    """Rays as an array, a view of cells that hold them all, and the cell of each."""
    uv = np.ascontiguousarray(uv, dtype=np.float64)
    if uv.ndim != 2 or uv.shape[1] != 2 or not np.isfinite(uv).all():
        raise InputError(f"rays must be finite pairs (ray, 2), got {uv.shape}")
    pair = _checked(vertices, triangles)
    none = np.empty((0, 4), np.int32)
    surface = Surfaces(*pair, np.array([0, len(pair[1])]), none, np.empty(0, np.bool_))
    side = int(np.clip(np.sqrt(min(len(pair[1]), len(uv)) / 2), 1, 512))
    low, high = (uv.min(axis=0), uv.max(axis=0)) if len(uv) else (np.zeros(2), np.zeros(2))
    size = np.maximum((high - low) / side, 1e-6 * np.maximum(1.0, np.maximum(abs(low), abs(high))))
    cells = (float(low[0]), float(low[1]), float(size[0]), float(size[1]))
    view = mesh_view(frame, side, side, surface, parallel, cells, with_outline=False)
    column, row = np.clip(np.floor((uv - low) / size), 0, side - 1).astype(np.int64).T
    return uv, view, row * side + column
