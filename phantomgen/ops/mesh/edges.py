"""Edges of triangle meshes, each with the triangles that meet there."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int32, Int64, Integer

# What passes a cell of a view: nothing, an edge where the surface turns sharply, an edge between a face seen from
# outside and one seen from inside.
PLAIN, CREASE, SILHOUETTE = 0, 1, 2
# Cosine of the angle between neighbouring faces, no unit: 26 degrees. Sharper edges are creases, flatter ones are taken
# for those of a smooth surface that is cut into triangles.
SHARP = 0.9


class EdgeUses(NamedTuple):
    """Sides of all triangles, those along the same edge one after the other.

    Parameters
    ----------
    sides : number ``3 triangle + side`` of each side; side s runs from vertex s to the next one
    forward : whether it runs from the vertex with the lower index to the other
    starts : first side of each edge
    counts : number of sides along each edge
    """

    sides: Int64[np.ndarray, " side"]
    forward: Bool[np.ndarray, " side"]
    starts: Int64[np.ndarray, " edge"]
    counts: Int64[np.ndarray, " edge"]


def edge_uses(triangles: Integer[np.ndarray, "triangle 3"]) -> EdgeUses:
    """Group the sides of the triangles by edge.

    Parameters
    ----------
    triangles : indices of vertices

    Returns
    -------
    the groups
    """
    begin = np.asarray(triangles, dtype=np.int64)
    end = np.roll(begin, -1, axis=1)
    keys = (np.minimum(begin, end) * (1 + begin.max(initial=0)) + np.maximum(begin, end)).ravel()
    sides = np.argsort(keys, kind="stable")
    keys = keys[sides]
    first = np.ones(len(keys), dtype=np.bool_)
    first[1:] = keys[1:] != keys[:-1]
    starts = np.flatnonzero(first)
    return EdgeUses(sides, (begin < end).ravel()[sides], starts, np.diff(starts, append=len(keys)))


def closed_edges(triangles: Integer[np.ndarray, "triangle 3"]) -> Int32[np.ndarray, "edge 4"]:
    """Find both ends and both triangles of each edge of a closed surface.

    Parameters
    ----------
    triangles : indices of vertices

    Returns
    -------
    two vertices and two triangles, (edge, 4)
    """
    sides, _, starts, _ = edge_uses(triangles)
    pairs = np.stack([sides[starts], sides[starts + 1]], axis=1)
    ends = np.asarray(triangles)[pairs[:, :1] // 3, np.stack([pairs[:, 0] % 3, (pairs[:, 0] + 1) % 3], axis=1)]
    return np.concatenate([ends, pairs // 3], axis=1).astype(np.int32)


def sharp_edges(
    vertices: Float[np.ndarray, "vertex 3"],
    triangles: Integer[np.ndarray, "triangle 3"],
    edges: Int32[np.ndarray, "edge 4"],
) -> Bool[np.ndarray, " edge"]:
    """Find the edges that are creases; those of a triangle without area are.

    Parameters
    ----------
    vertices : corners (x, y, z) [mm]
    triangles : indices of vertices
    edges : as `closed_edges` returns them

    Returns
    -------
    True for creases
    """
    p, q, r = (vertices[triangles[:, i]] for i in range(3))
    normals = np.cross(q - p, r - p)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.finfo(np.float64).tiny)
    return np.einsum("ei,ei->e", normals[edges[:, 2]], normals[edges[:, 3]]) < SHARP
