"""Which cells of a view the outline of a mesh passes, in numba."""

from typing import no_type_check

import numpy as np
from numba import njit

from phantomgen.ops.kernel_decorators import inlined
from phantomgen.ops.mesh.cpu import MARGIN, NEAR, A, B, W, clip, span
from phantomgen.ops.mesh.edges import CREASE, PLAIN, SILHOUETTE


@inlined
@no_type_check
def _faces(corners, triangles, k):
    """Whether a triangle is seen from the side where its vertices run clockwise: the sign of a determinant."""
    p, q, r = triangles[k, 0], triangles[k, 1], triangles[k, 2]
    a, b, w = corners[p, A], corners[p, B], corners[p, W]
    qa, qb, qw = corners[q, A] - a, corners[q, B] - b, corners[q, W] - w
    ra, rb, rw = corners[r, A] - a, corners[r, B] - b, corners[r, W] - w
    return a * (qb * rw - qw * rb) + b * (qw * ra - qa * rw) + w * (qa * rb - qb * ra) > 0.0


@inlined
@no_type_check
def _place(corners, i, j, cells):
    """Column and row in cells of vertex i; of the point where its edge to j comes in sight if it lies behind."""
    a, b, w = corners[i, A], corners[i, B], corners[i, W]
    if w < NEAR:
        part = (NEAR - w) / (corners[j, W] - w)
        a, b, w = a + part * (corners[j, A] - a), b + part * (corners[j, B] - b), NEAR
    return (a / w - cells[0]) / cells[2], (b / w - cells[1]) / cells[3]


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def mark_outline(corners, triangles, edges, sharp, cells, facing, out):
    """Raise the cells that a crease or a silhouette may pass.

    Parameters
    ----------
    corners, triangles : homogeneous coordinates (vertex, 4) of one view; vertices (triangle, 3)
    edges, sharp : both ends and both triangles of each edge (edge, 4); whether the surface turns sharply there
    cells : u and v where the grid of cells begins, and the size of a cell
    facing : scratch, one byte per triangle
    out : (row, column), raised to CREASE or SILHOUETTE
    """
    rows, columns = out.shape
    for k in range(triangles.shape[0]):
        facing[k] = _faces(corners, triangles, k)
    for e in range(edges.shape[0]):
        kind = SILHOUETTE if facing[edges[e, 2]] != facing[edges[e, 3]] else (CREASE if sharp[e] else PLAIN)
        i, j = edges[e, 0], edges[e, 1]
        if kind == PLAIN or max(corners[i, W], corners[j, W]) < NEAR:
            continue
        x, y = _place(corners, i, j, cells)
        end_x, end_y = _place(corners, j, i, cells)
        top, bottom = span(min(y, end_y), max(y, end_y), rows)
        for row in range(top, bottom):
            least, most = clip(x, y, end_x, end_y, row - MARGIN, row + 1.0 + MARGIN, np.inf, -np.inf)
            if least <= most:
                left, right = span(least, most, columns)
                for column in range(left, right):
                    out[row, column] = max(out[row, column], kind)
