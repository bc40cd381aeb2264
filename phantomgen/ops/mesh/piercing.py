"""Faces of a mesh that cross each other, in numba.

Two triangles in general position cross where an edge of one pierces the other. Pairs that lie in a common cell of a
grid are tested; signs of volumes count only when rounding cannot have made them, so that nothing is reported that is
not so. Contact without piercing, and overlap within a plane, are not reported.
"""

from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Bool, Float, Int64
from numba import njit

from phantomgen.ops.kernel_decorators import called, inlined

# No unit; bound on the rounding of a determinant, relative to the sum of its terms' sizes: some times 1e-16.
_ROUNDING = 1e-15
# Most cells along an axis of the grid, and most entries per triangle: bounds of memory and time, no change of results.
_FINEST, _ENTRIES = 128, 30


class TriangleGrid(NamedTuple):
    """Triangles in the cells of a grid.

    Parameters
    ----------
    first : first cell of each triangle along every axis
    shape : number of cells along every axis
    ends : cell c lists ``entries[ends[c] : ends[c + 1]]``
    entries : triangles
    """

    first: Int64[np.ndarray, "triangle 3"]
    shape: Int64[np.ndarray, " 3"]
    ends: Int64[np.ndarray, " boundary"]
    entries: Int64[np.ndarray, " entry"]


def piercing_faces(
    vertices: Float[np.ndarray, "vertex 3"], triangles: Int64[np.ndarray, "triangle 3"]
) -> Bool[np.ndarray, " triangle"]:
    """Find the triangles that pierce, or are pierced by, another one.

    Parameters
    ----------
    vertices, triangles : the mesh [mm]

    Returns
    -------
    True for these triangles
    """
    corners = vertices[triangles]
    lows, highs = corners.min(axis=1), corners.max(axis=1)
    low, reach = lows.min(axis=0), np.maximum(np.ptp(vertices[triangles.ravel()], axis=0), np.finfo(np.float64).tiny)
    size = max(2 * float((highs - lows).mean()), float(reach.max()) / _FINEST)
    while True:
        shape = np.floor(reach / size).astype(np.int64) + 1
        first = np.minimum(np.floor((lows - low) / size).astype(np.int64), shape - 1)
        last = np.minimum(np.floor((highs - low) / size).astype(np.int64), shape - 1)
        if (shape == 1).all() or (last - first + 1).prod(axis=1).sum() <= _ENTRIES * len(triangles) + 10_000:
            break
        size *= 2
    ends = np.zeros(shape.prod() + 1, dtype=np.int64)
    _list_cells(first, last, shape, ends[1:], np.empty(0, np.int64), False)
    np.cumsum(ends, out=ends)
    entries = np.empty(ends[-1], dtype=np.int64)
    _list_cells(first, last, shape, ends[:-1].copy(), entries, True)
    found = np.zeros(len(triangles), dtype=np.bool_)
    _test_pairs(vertices, triangles, lows, highs, TriangleGrid(first, shape, ends, entries), found)
    return found


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def _list_cells(first, last, shape, starts, entries, listing):
    """Count the triangles in each cell, or list them, by the first and last cell of each along every axis."""
    for k in range(first.shape[0]):
        for i in range(first[k, 0], last[k, 0] + 1):
            for j in range(first[k, 1], last[k, 1] + 1):
                for n in range(first[k, 2], last[k, 2] + 1):
                    cell = (i * shape[1] + j) * shape[2] + n
                    if listing:
                        entries[starts[cell]] = k
                    starts[cell] += 1


@called
@no_type_check
def _side(x, a, b, c, d):
    """Sign of the volume of the vertices a, b, c, d; 0 where rounding could have made it."""
    ux, uy, uz = x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2]
    vx, vy, vz = x[c, 0] - x[a, 0], x[c, 1] - x[a, 1], x[c, 2] - x[a, 2]
    wx, wy, wz = x[d, 0] - x[a, 0], x[d, 1] - x[a, 1], x[d, 2] - x[a, 2]
    volume = ux * (vy * wz - vz * wy) + uy * (vz * wx - vx * wz) + uz * (vx * wy - vy * wx)
    bound = abs(ux) * (abs(vy * wz) + abs(vz * wy)) + abs(uy) * (abs(vz * wx) + abs(vx * wz))
    bound = _ROUNDING * (bound + abs(uz) * (abs(vx * wy) + abs(vy * wx)))
    return int(volume > bound) - int(volume < -bound)


@inlined
@no_type_check
def _pierces(x, side_p, side_q, p, q, a, b, c):
    """Whether the edge p q, whose ends lie on these sides of the triangle a b c, passes through it."""
    if side_p * side_q >= 0:
        return False
    turn = _side(x, p, q, a, b)
    return turn != 0 and turn == _side(x, p, q, b, c) and turn == _side(x, p, q, c, a)


@called
@no_type_check
def _cross(x, p, q, r, a, b, c):
    """Whether an edge of one of the triangles p q r and a b c passes through the other."""
    side_p, side_q, side_r = _side(x, a, b, c, p), _side(x, a, b, c, q), _side(x, a, b, c, r)
    if min(side_p, side_q, side_r) >= 0 or max(side_p, side_q, side_r) <= 0:
        return False
    side_a, side_b, side_c = _side(x, p, q, r, a), _side(x, p, q, r, b), _side(x, p, q, r, c)
    if min(side_a, side_b, side_c) >= 0 or max(side_a, side_b, side_c) <= 0:
        return False
    if _pierces(x, side_p, side_q, p, q, a, b, c) or _pierces(x, side_q, side_r, q, r, a, b, c):
        return True
    if _pierces(x, side_r, side_p, r, p, a, b, c) or _pierces(x, side_a, side_b, a, b, p, q, r):
        return True
    return _pierces(x, side_b, side_c, b, c, p, q, r) or _pierces(x, side_c, side_a, c, a, p, q, r)


@inlined
@no_type_check
def _apart(triangles, lows, highs, k, m):
    """Whether boxes around two triangles do not meet, or the triangles share an edge."""
    for axis in range(3):
        if highs[k, axis] < lows[m, axis] or highs[m, axis] < lows[k, axis]:
            return True
    shared = 0
    for i in range(3):
        for j in range(3):
            shared += int(triangles[k, i] == triangles[m, j])
    return shared > 1


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def _test_pairs(x, triangles, lows, highs, grid, found):
    """Mark the triangles that cross another one; a pair is tested in the first cell that both are in."""
    first, shape, ends, entries = grid
    for cell in range(ends.size - 1):
        i, j, n = cell // (shape[1] * shape[2]), cell // shape[2] % shape[1], cell % shape[2]
        for one in range(ends[cell], ends[cell + 1]):
            k = entries[one]
            p, q, r = triangles[k, 0], triangles[k, 1], triangles[k, 2]
            for other in range(one + 1, ends[cell + 1]):
                m = entries[other]
                if max(first[k, 0], first[m, 0]) != i or max(first[k, 1], first[m, 1]) != j:
                    continue
                if max(first[k, 2], first[m, 2]) != n or _apart(triangles, lows, highs, k, m):
                    continue
                a, b, c = triangles[m, 0], triangles[m, 1], triangles[m, 2]
                if _cross(x, p, q, r, a, b, c):
                    found[k] = found[m] = True
