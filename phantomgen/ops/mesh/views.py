"""Meshes as kernels want them, and their projection to one view."""

from collections.abc import Iterable
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int32, Int64, UInt8

from phantomgen.ops.mesh.edges import closed_edges, sharp_edges
from spectra.errors import InputError

if TYPE_CHECKING:
    from phantomgen.ops.mesh.cpu import CellLists, TracedMeshes


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
        """Create surfaces of closed meshes: two triangles meet at every edge.

        Parameters
        ----------
        meshes : vertices [mm] and triangles of each

        Returns
        -------
        the surfaces
        """
        pairs = [_ordered(*checked_mesh(vertices, triangles)) for vertices, triangles in meshes]
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
    """Meshes in one view, with the triangles that the rays through each cell may meet.

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

    @property
    def pieces(self) -> int:
        """Most pieces of a ray that lie in meshes."""
        return len(self.starts) * (self.room // 2 + 1)

    def lists(self, mesh: int) -> "CellLists":
        """Return one mesh with the lists of its cells.

        Parameters
        ----------
        mesh : number of the mesh

        Returns
        -------
        argument of the kernels for many rays
        """
        from phantomgen.ops.mesh.cpu import CellLists  # noqa: PLC0415 - numba only where there are meshes

        return CellLists(self.corners, self.triangles, self.starts[mesh], self.candidates)

    def traced(self) -> "TracedMeshes":
        """Return the meshes with scratch memory of their own.

        Returns
        -------
        argument of `phantomgen.ops.mesh.cpu.list_pieces`
        """
        from phantomgen.ops.mesh.cpu import ListedPieces, TracedMeshes  # noqa: PLC0415

        first, last = np.empty((2, len(self.starts)), dtype=np.int64)
        pieces = ListedPieces(first, last, np.empty((self.pieces, 2)))
        return TracedMeshes(*self[:4], np.empty(self.room), pieces)


def open_surface(vertices: np.ndarray, triangles: np.ndarray) -> Surfaces:
    """Create the surfaces of one mesh, without edges.

    Parameters
    ----------
    vertices, triangles : the mesh [mm]

    Returns
    -------
    the surfaces
    """
    pair = checked_mesh(vertices, triangles)
    return Surfaces(*pair, np.array([0, len(pair[1])]), np.empty((0, 4), np.int32), np.empty(0, np.bool_))


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

    Returns
    -------
    the view

    Raises
    ------
    InputError
        When the rays lie in one plane.
    """
    from phantomgen.ops.mesh import cpu  # noqa: PLC0415 - numba is only worth its import when there are meshes

    frame, grid = np.ascontiguousarray(frame, dtype=np.float64), np.array(cells, dtype=np.float64)
    matrix, offset = _projection(frame, parallel)
    vertices, triangles, parts, edges, sharp = surfaces
    corners, places = np.empty((len(vertices), 4)), np.empty((len(vertices), 2))
    cpu.project(vertices, matrix, offset, bool(parallel), grid, corners, places)
    starts = np.zeros((len(parts) - 1, rows * columns + 1), dtype=np.int64)
    none = np.empty(0, dtype=np.int32)
    mesh = cpu.ProjectedMesh(corners, places, triangles)
    for m, (begin, end) in enumerate(pairwise(parts)):
        cpu.bin_triangles(mesh, begin, end, grid, columns, starts[m, 1:], none, False)
    room = int(starts.max(initial=0)) + 1
    flat = starts.reshape(-1)
    np.cumsum(flat, out=flat)
    candidates = np.empty(flat[-1] if flat.size else 0, dtype=np.int32)
    for m, (begin, end) in enumerate(pairwise(parts)):
        next_entry = starts[m, :-1].copy()
        cpu.bin_triangles(mesh, begin, end, grid, columns, next_entry, candidates, True)
    outline = np.zeros((rows, columns), dtype=np.uint8)
    if with_outline:
        from phantomgen.ops.mesh.outline import mark_outline  # noqa: PLC0415

        mark_outline(corners, triangles, edges, sharp, grid, np.empty(len(triangles), np.bool_), outline)
    return MeshView(corners, triangles, starts, candidates, room, outline)


def checked_mesh(vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Check a mesh, and convert its arrays to the types of the kernels.

    Parameters
    ----------
    vertices, triangles : the mesh [mm]

    Returns
    -------
    the two arrays

    Raises
    ------
    InputError
        When the arrays would make a kernel read outside of them, or are not finite.
    """
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
    """Sort vertices and triangles along a Z-order curve; a mesh in random order takes five times as long to trace."""
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
