"""Check of triangle surfaces; each error is one sentence with a way to repair the surface."""

import numpy as np
from jaxtyping import Float, Int64

from phantomgen.ops.mesh import enclosures, overlaps
from phantomgen.ops.mesh.edges import EdgeUses, closed_edges, edge_uses
from spectra.errors import InputError

_UNITE = "unite the bodies, e.g. with trimesh.boolean.union(mesh.split()), or drop what lies inside"


def check_surface(
    vertices: Float[np.ndarray, "vertex 3"], triangles: Int64[np.ndarray, "triangle 3"], name: str
) -> None:
    """Refuse a surface unless every point of space is clearly inside or outside of it.

    Parameters
    ----------
    vertices : (x, y, z) [mm], (vertex, 3)
    triangles : indices of vertices, (triangle, 3)
    name : name of the mesh in messages

    Raises
    ------
    InputError
        Naming what is wrong, how many faces it concerns, and what repairs it; the first of these that applies: arrays
        of the wrong kind, faces with a repeated corner, duplicate faces, holes, edges of more than two faces, faces
        that are turned over, faces that pierce another one, bodies without volume, inside out, or within
        another one.
    """
    _check_arrays(vertices, triangles, name)
    repeated = int((triangles == np.roll(triangles, 1, axis=1)).any(axis=1).sum())
    if repeated:
        raise InputError(
            f"{name}: {_faces(repeated)} without three corners of their own; "
            "drop them, e.g. with trimesh's mesh.update_faces(mesh.nondegenerate_faces())"
        )
    uses = edge_uses(triangles)
    _check_edges(triangles, uses, name)
    _check_crossing(vertices, triangles, name)
    _check_bodies(vertices, triangles, name)


def _faces(count: int) -> str:
    return f"{count} face{'s' if count != 1 else ''}"


def _check_arrays(vertices: np.ndarray, triangles: np.ndarray, name: str) -> None:
    if vertices.ndim != 2 or vertices.shape[1] != 3 or triangles.ndim != 2 or triangles.shape[1] != 3:
        raise InputError(
            f"{name}: a mesh needs vertices (vertex, 3) and triangles (triangle, 3), "
            f"got {vertices.shape} and {triangles.shape}"
        )
    if not len(triangles):
        raise InputError(f"{name}: a mesh needs triangles, there are none")
    if triangles.min() < 0 or triangles.max() >= len(vertices):
        raise InputError(
            f"{name}: triangles must name vertices 0..{len(vertices) - 1}, got {triangles.min()}..{triangles.max()}"
        )
    wrong = int((~(np.abs(vertices) <= 1e9)).any(axis=1).sum())
    if wrong:
        raise InputError(f"{name}: vertices must be finite and within 1e9 mm, {wrong} of {len(vertices)} are not")


def _check_edges(triangles: np.ndarray, uses: EdgeUses, name: str) -> None:
    """Two different faces at every edge, which run along it in opposite directions."""

    def faces_at(edges: np.ndarray) -> int:
        """Number of faces at some of the edges."""
        chosen = np.repeat(edges, uses.counts)
        return len(np.unique(uses.sides[chosen] // 3))

    # Two faces at an edge with the same corner opposite to it are one and the same.
    opposite = triangles[uses.sides // 3, (uses.sides + 2) % 3]
    pairs = uses.starts[uses.counts == 2]
    twice = bool((opposite[pairs] == opposite[pairs + 1]).any()) or bool((uses.counts > 2).any())
    if twice:
        distinct = len(np.unique(np.sort(triangles, axis=1), axis=0))
        if distinct < len(triangles):
            raise InputError(
                f"{name}: {_faces(len(triangles) - distinct)} repeat another one; "
                "drop them, e.g. with trimesh's mesh.update_faces(mesh.unique_faces())"
            )
    holes = uses.counts == 1
    if holes.any():
        raise InputError(
            f"{name}: the surface is not closed: {_faces(faces_at(holes))} end at one of {holes.sum()} open edges; "
            "close it, e.g. with trimesh.repair.fill_holes, or join the vertices that should be one"
        )
    crowded = uses.counts > 2
    if crowded.any():
        raise InputError(
            f"{name}: {_faces(faces_at(crowded))} meet at {crowded.sum()} edges that have more than two; "
            "split bodies that touch into files of their own, e.g. with trimesh's mesh.split(), or drop inner faces"
        )
    turned = uses.forward[uses.starts] == uses.forward[uses.starts + 1]
    if turned.any():
        raise InputError(
            f"{name}: {_faces(faces_at(turned))} disagree with a neighbour about which side is outside; "
            "turn them, e.g. with trimesh.repair.fix_normals"
        )


def _check_bodies(vertices: np.ndarray, triangles: np.ndarray, name: str) -> None:
    """Bodies face outwards, cavities in them face inwards, and so on for bodies in cavities; none overlap."""
    from scipy.sparse import coo_array  # noqa: PLC0415 - half a second that only meshes need
    from scipy.sparse.csgraph import connected_components  # noqa: PLC0415

    pairs = closed_edges(triangles)[:, 2:]
    links = coo_array((np.ones(len(pairs), np.bool_), (pairs[:, 0], pairs[:, 1])), shape=(len(triangles),) * 2)
    count, labels = connected_components(links, directed=False)
    labels = labels.astype(np.int64)
    p, q, r = (vertices[triangles[:, i]] for i in range(3))
    normals = np.cross(q - p, r - p)
    areas = np.linalg.norm(normals, axis=1)
    order = np.lexsort([areas, labels])
    largest = order[np.flatnonzero(np.diff(labels[order], append=count))]
    six_volumes = np.einsum("ki,ki->k", p - p[largest][labels], normals)
    volumes = np.bincount(labels, six_volumes, count)
    flat = abs(volumes) <= 1e-12 * np.bincount(labels, abs(six_volumes), count)
    if flat.any():
        raise InputError(
            f"{name}: {_faces(int(flat[labels].sum()))} enclose no volume; drop them, e.g. with trimesh's mesh.split()"
        )
    # A point next to the largest face of each body, on its inner side, where a body that touches it is not.
    inwards = -np.sign(volumes)[:, None] * normals[largest] / np.sqrt(areas[largest])[:, None]
    points = (p + q + r)[largest] / 3 + 1e-8 * inwards
    depth = enclosures(points, vertices, triangles, labels, np.arange(count))
    within = depth % 2 == 1
    inverted = (volumes < 0) & ~within
    if inverted.any():
        raise InputError(
            f"{name}: {_faces(int(inverted[labels].sum()))} of {inverted.sum()} of {count} bodies are inside out; "
            "turn them, e.g. with trimesh's mesh.invert()"
        )
    doubled = (volumes > 0) & within
    if doubled.any():
        raise InputError(
            f"{name}: {_faces(int(doubled[labels].sum()))} of {doubled.sum()} of {count} bodies lie within another; "
            f"turn those around a cavity, e.g. with trimesh's mesh.invert(), or {_UNITE}"
        )
    overlapping = int(overlaps(vertices, triangles).sum())
    if overlapping:
        raise InputError(f"{name}: {_faces(overlapping)} at least lie within another body; {_UNITE}")


def _check_crossing(vertices: np.ndarray, triangles: np.ndarray, name: str) -> None:
    from phantomgen.ops.mesh.piercing import piercing_faces  # noqa: PLC0415 - numba only where it computes

    crossing = int(piercing_faces(vertices, triangles).sum())
    if crossing:
        raise InputError(f"{name}: {_faces(crossing)} cross another one; {_UNITE}")
