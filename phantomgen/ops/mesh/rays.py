"""Any rays through meshes, also those that belong to no panel."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int64

from phantomgen.ops.mesh.views import MeshView, Surfaces, mesh_view, open_surface
from spectra.errors import InputError

# No unit, relative to the diagonal of the mesh; shorter overlaps of bodies may be rounding.
_SHORTEST_OVERLAP = 1e-9


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
    frame : of the view, as in `mesh_view` [mm]
    uv : column and row where each ray meets the panel, not necessarily on it [pixel]
    vertices, triangles : the mesh [mm]
    parallel : whether the rays are parallel

    Returns
    -------
    lengths [mm], (ray,)
    """
    from phantomgen.ops.mesh.cpu import ray_lengths  # noqa: PLC0415

    uv, view, at = _cells_of_rays(frame, uv, open_surface(vertices, triangles), parallel)
    directions = frame[0] if parallel else frame[1] + uv @ frame[2:]
    norms = np.linalg.norm(directions, axis=-1) + np.zeros(len(uv))
    out = np.empty(len(uv))
    ray_lengths(view.lists(0), uv, at, norms, np.empty(view.room), out)
    return out


def mesh_crossings(
    frame: Float[np.ndarray, "4 3"],
    uv: Float[np.ndarray, "ray 2"],
    vertices: Float[np.ndarray, "vertex 3"],
    triangles: Int64[np.ndarray, "triangle 3"],
    parallel: bool = False,
) -> tuple[Int64[np.ndarray, " boundary"], Float[np.ndarray, " crossing"]]:
    """Find all places t > 0 where each ray (u, v) crosses a closed mesh, also beyond the panel (t > 1).

    Parameters
    ----------
    frame, uv, vertices, triangles, parallel : as in `mesh_lengths`

    Returns
    -------
    starts, places : ray i crosses at ``places[starts[i] : starts[i + 1]]``, ascending: an even number of times, an odd
        number if it begins inside
    """
    from phantomgen.ops.mesh.cpu import ray_crossings  # noqa: PLC0415

    uv, view, at = _cells_of_rays(frame, uv, open_surface(vertices, triangles), parallel)
    counts, found = np.empty(len(uv), dtype=np.int64), np.empty(view.room)
    lists = view.lists(0)
    ray_crossings(lists, uv, at, found, counts, found, False)
    starts = np.concatenate([[0], np.cumsum(counts)])
    places = np.empty(starts[-1])
    ray_crossings(lists, uv, at, found, counts, places, True)
    return starts, places


def mesh_intervals(
    origins: Float[np.ndarray, "ray 3"], directions: Float[np.ndarray, "ray 3"], surfaces: Surfaces
) -> tuple[Int64[np.ndarray, "mesh boundary"], Float[np.ndarray, "interval 2"]]:
    """Where rays ``origin + t direction``, 0 <= t <= 1, are inside of each mesh.

    All meshes are projected once per distinct origin (and side of a cube around it): rays should share origins.

    Parameters
    ----------
    origins, directions : start of each ray, and the vector from there to its end [mm]
    surfaces : the meshes

    Returns
    -------
    starts, ends : ray i is inside of mesh m between the two t of each of ``ends[starts[m, i] : starts[m, i + 1]]``
    """
    from phantomgen.ops.mesh.cpu import ray_intervals  # noqa: PLC0415

    origins, directions = (np.asarray(a, dtype=np.float64).reshape(-1, 3) for a in (origins, directions))
    axis = abs(directions).argmax(axis=1)
    main = np.take_along_axis(directions, axis[:, None], axis=1)[:, 0]
    keys, group = np.unique(np.column_stack([origins, axis, main < 0]), axis=0, return_inverse=True)
    meshes, order = len(surfaces.parts) - 1, np.argsort(group.reshape(-1), kind="stable")
    owners, rays, ends = [np.empty(0, np.int64)], [np.empty(0, np.int64)], [np.empty((0, 2))]
    for key, chosen in zip(keys, np.split(order, np.cumsum(np.bincount(group.reshape(-1)))[:-1]), strict=True):
        chosen = chosen[main[chosen] != 0]  # noqa: PLW2901 - a ray without length is nowhere
        forward = np.eye(3)[int(key[3])] * (1 - 2 * key[4])
        across = np.delete(np.eye(3), int(key[3]), axis=0)
        reach = abs(main[chosen])
        frame = np.concatenate([key[None, :3], forward[None], across])
        uv, view, at = _cells_of_rays(frame, directions[chosen] @ across.T / reach[:, None], surfaces, False)
        counts, found = np.empty(len(uv), np.int64), np.empty(view.room)
        for m in range(meshes):
            lists = view.lists(m)
            ray_intervals(lists, uv, at, reach, found, counts, np.empty((0, 2)), False)
            ends.append(np.empty((counts.sum(), 2)))
            ray_intervals(lists, uv, at, reach, found, counts, ends[-1], True)
            rays.append(np.repeat(chosen, counts))
            owners.append(np.full(counts.sum(), m))
    place = np.concatenate(owners) * len(origins) + np.concatenate(rays)
    starts = np.zeros(meshes * len(origins) + 1, np.int64)
    np.cumsum(np.bincount(place, minlength=meshes * len(origins)), out=starts[1:])
    steps = np.arange(meshes)[:, None] * len(origins) + np.arange(len(origins) + 1)
    return starts[steps], np.concatenate(ends)[np.argsort(place, kind="stable")]


def enclosures(
    points: Float[np.ndarray, "point 3"],
    vertices: Float[np.ndarray, "vertex 3"],
    triangles: Int64[np.ndarray, "triangle 3"],
    labels: Int64[np.ndarray, " triangle"] | None = None,
    own: Int64[np.ndarray, " point"] | None = None,
) -> Int64[np.ndarray, " point"]:
    """Count the crossings above each point on a line along z: an odd number for points inside.

    Parameters
    ----------
    points : (x, y, z) [mm]
    vertices, triangles : the mesh [mm]
    labels, own : label of each triangle, and of each point; crossings of triangles with the point's label do not count

    Returns
    -------
    numbers of crossings, (point,)
    """
    from phantomgen.ops.mesh.cpu import count_beyond  # noqa: PLC0415

    if labels is None or own is None:
        labels, own = np.zeros(len(triangles), np.int64), np.ones(len(points), np.int64)
    x, y, z = np.eye(3)
    points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    uv, view, at = _cells_of_rays(np.stack([z, 0 * z, x, y]), points[:, :2], open_surface(vertices, triangles), True)
    depths, out = np.ascontiguousarray(points[:, 2]), np.empty(len(points), np.int64)
    count_beyond(view.lists(0), uv, at, depths, labels, own, out)
    return out


def overlaps(
    vertices: Float[np.ndarray, "vertex 3"], triangles: Int64[np.ndarray, "triangle 3"], lines: int = 128
) -> Bool[np.ndarray, " triangle"]:
    """Find the faces where bodies overlap: a line enters one body twice, or leaves it twice, there.

    Parameters
    ----------
    vertices, triangles : a closed mesh whose neighbouring triangles agree about which side is outside [mm]
    lines : number of lines across the mesh in both directions, all along a direction that faces seldom have

    Returns
    -------
    True for these faces
    """
    from phantomgen.ops.mesh.cpu import OverlapScratch, mark_overlaps  # noqa: PLC0415

    axes = np.linalg.qr([[0.3, 0.5, 0.81], [0.47, -0.8, 0.33], [0.7, 0.2, -0.6]])[0]
    axes[2] *= np.linalg.det(axes)
    middle = vertices.min(axis=0) / 2 + vertices.max(axis=0) / 2
    places = (vertices - middle) @ axes.T
    low, high = places.min(axis=0), places.max(axis=0)
    part = (np.arange(lines) + 0.5) / lines
    uv = np.stack(np.meshgrid(*(low[:2] + part[:, None] * (high - low)[:2]).T), axis=-1).reshape(-1, 2)
    frame = np.stack([axes[2], middle, axes[0], axes[1]])
    uv, view, at = _cells_of_rays(frame, uv, open_surface(vertices, triangles), True)
    scratch = OverlapScratch(np.empty(view.room), np.empty(view.room, np.int64), np.empty(view.room, np.bool_))
    out = np.zeros(len(triangles), np.bool_)
    mark_overlaps(view.lists(0), uv, at, scratch, _SHORTEST_OVERLAP * float(np.linalg.norm(high - low)), out)
    return out


class _CellRays(NamedTuple):
    """Rays as an array, a view of cells that hold them all, and the cell of each."""

    uv: Float[np.ndarray, "ray 2"]
    view: MeshView
    at: Int64[np.ndarray, " ray"]


def _cells_of_rays(frame: np.ndarray, uv: np.ndarray, surfaces: Surfaces, parallel: bool) -> _CellRays:
    """Sort rays into the cells of a view."""
    uv = np.ascontiguousarray(uv, dtype=np.float64)
    if uv.ndim != 2 or uv.shape[1] != 2 or not np.isfinite(uv).all():
        raise InputError(f"rays must be finite pairs (ray, 2), got {uv.shape}")
    side = int(np.clip(np.sqrt(min(len(surfaces.triangles), len(uv)) / 2), 1, 512))
    low, high = (uv.min(axis=0), uv.max(axis=0)) if len(uv) else (np.zeros(2), np.zeros(2))
    size = np.maximum((high - low) / side, 1e-6 * np.maximum(1.0, np.maximum(abs(low), abs(high))))
    cells = (float(low[0]), float(low[1]), float(size[0]), float(size[1]))
    view = mesh_view(frame, side, side, surfaces, parallel, cells, with_outline=False)
    column, row = np.clip(np.floor((uv - low) / size), 0, side - 1).astype(np.int64).T
    return _CellRays(uv, view, row * side + column)
