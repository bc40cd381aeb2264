"""Rays through closed triangle meshes in numba: lists of triangles per cell, and crossings of one ray.

A view gives every vertex homogeneous coordinates ``(a, b, w, t)``: the ray (u, v) is where ``a = u w`` and ``b = v w``,
and t is the place along it (from a point source t = w, along parallel lines w = 1). For one ray let ``f = b - v w`` and
``g = a - u w``; the plane f = 0 contains the ray and cuts a triangle in a segment between two of its edges, and the ray
meets the triangle where that segment passes g = 0.

The edge rule: a vertex is above the plane where ``f > 0``, and the section of an edge from an upper vertex P to a
lower one M lies to the right where ``g_M f_P - g_P f_M > 0``. A triangle is crossed when of its two sections one lies
to the right. Both statements are made per vertex and per edge, by the same operations for every triangle that shares
it, so each edge counts in two triangles or in none and every line crosses a closed surface an even number of times,
whatever rounding did to f and g: there is no tolerance, and vertices, edges and faces seen edge on are no exceptions.
"""

from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Bool, Float, Int32, Int64
from numba import njit

from phantomgen.ops.kernel_decorators import called, inlined

# Columns of a table of corners: the homogeneous coordinates of a vertex.
A, B, W, T = 0, 1, 2, 3
# How far beyond its cell a triangle is still listed: cells; no unit, relative to the coordinates that the place was
# computed from. Both far above the rounding of a float64, 1e-16, and too small to list many triangles more.
MARGIN, _RELATIVE = 1e-6, 1e-12
# Part of the way from source to panel, no unit; a vertex nearer to the source is not divided by its w, which may be 0.
NEAR = 1e-9


class CellLists(NamedTuple):
    """One mesh in a view, with the triangles that rays through each cell may meet.

    Parameters
    ----------
    corners : homogeneous coordinates of each vertex
    triangles : indices of vertices
    starts : rays in a cell may meet the triangles ``candidates[starts[cell] : starts[cell + 1]]``
    candidates : indices of triangles
    """

    corners: Float[np.ndarray, "vertex 4"]
    triangles: Int32[np.ndarray, "triangle 3"]
    starts: Int64[np.ndarray, " boundary"]
    candidates: Int32[np.ndarray, " entry"]


class ListedPieces(NamedTuple):
    """Pieces of a ray that lie in meshes.

    Parameters
    ----------
    first, last : mesh m has the pieces ``first[m]`` to ``last[m]``
    ends : t where each piece begins and ends
    """

    first: Int64[np.ndarray, " mesh"]
    last: Int64[np.ndarray, " mesh"]
    ends: Float[np.ndarray, "piece 2"]


class TracedMeshes(NamedTuple):
    """All meshes in a view, with scratch memory for one ray.

    Parameters
    ----------
    corners, triangles, starts, candidates : as in `phantomgen.ops.mesh.views.MeshView`
    found : scratch of `intervals`
    pieces : written by `list_pieces`
    """

    corners: Float[np.ndarray, "vertex 4"]
    triangles: Int32[np.ndarray, "triangle 3"]
    starts: Int64[np.ndarray, "mesh boundary"]
    candidates: Int32[np.ndarray, " entry"]
    found: Float[np.ndarray, " crossing"]
    pieces: ListedPieces


class ProjectedMesh(NamedTuple):
    """Vertices of a mesh in a view, and its triangles.

    Parameters
    ----------
    corners, places : vertices as `project` writes them
    triangles : indices of vertices
    """

    corners: Float[np.ndarray, "vertex 4"]
    places: Float[np.ndarray, "vertex 2"]
    triangles: Int32[np.ndarray, "triangle 3"]


class OverlapScratch(NamedTuple):
    """Scratch memory of `mark_overlaps`, as long as the longest list of a cell.

    Parameters
    ----------
    places : t where the line crosses triangles
    faces : these triangles
    turns : whether the line enters there
    """

    places: Float[np.ndarray, " crossing"]
    faces: Int64[np.ndarray, " crossing"]
    turns: Bool[np.ndarray, " crossing"]


@inlined
@no_type_check
def meet(corners, triangles, k, u, v):
    """Test whether the line of a ray crosses a triangle.

    Parameters
    ----------
    corners, triangles : homogeneous coordinates of vertices (vertex, 4); indices of vertices (triangle, 3)
    k : number of the triangle
    u, v : the ray

    Returns
    -------
    whether it crosses, t where it does, and whether corners run from b to a there
    """
    p, q, r = triangles[k, 0], triangles[k, 1], triangles[k, 2]
    fp = corners[p, B] - v * corners[p, W]
    fq = corners[q, B] - v * corners[q, W]
    fr = corners[r, B] - v * corners[r, W]
    above = fp > 0.0
    if above == (fq > 0.0):
        if above == (fr > 0.0):
            return False, 0.0, False
        p, q, r, fp, fq, fr = r, p, q, fr, fp, fq
    elif above == (fr > 0.0):
        p, q, r, fp, fq, fr = q, r, p, fq, fr, fp
    # p is alone on its side of the plane
    gp = corners[p, A] - u * corners[p, W]
    gq = corners[q, A] - u * corners[q, W]
    gr = corners[r, A] - u * corners[r, W]
    if fp > 0.0:
        side_q, side_r = gq * fp - gp * fq, gr * fp - gp * fr
    else:
        side_q, side_r = gp * fq - gq * fp, gp * fr - gr * fp
    if (side_q > 0.0) == (side_r > 0.0):
        return False, 0.0, False
    side_q, side_r = side_q / abs(fp - fq), side_r / abs(fp - fr)
    tp = corners[p, T]
    tq = tp + (corners[q, T] - tp) * (fp / (fp - fq))
    tr = tp + (corners[r, T] - tp) * (fp / (fp - fr))
    t = tq + (tr - tq) * (side_q / (side_q - side_r)) if side_q != side_r else tq
    return True, t, (fp > 0.0) == (side_q > side_r)


@inlined
@no_type_check
def crossings(lists, first, last, u, v, found):
    """Write the places t > 0 where a ray crosses the listed triangles, ascending.

    Parameters
    ----------
    lists : corners (vertex, 4), triangles (triangle, 3) and candidates (entry,) as in `CellLists`
    first, last : the triangles ``candidates[first:last]`` may be met
    u, v : the ray
    found : room for ``last - first + 1`` numbers, written

    Returns
    -------
    number of places, odd when the ray begins inside
    """
    corners, triangles, candidates = lists
    count = 0
    for i in range(first, last):
        met, t, _ = meet(corners, triangles, candidates[i], u, v)
        if met and t > 0.0:
            at = count
            while at > 0 and found[at - 1] > t:
                found[at] = found[at - 1]
                at -= 1
            found[at] = t
            count += 1
    return count


@inlined
@no_type_check
def intervals(lists, first, last, u, v, reach, found):
    """Write where a ray is inside: from ``found[2 i]`` to ``found[2 i + 1]``, ascending.

    Parameters
    ----------
    lists, first, last, u, v : as in `crossings`
    reach : the ray ends at this t
    found : as in `crossings`

    Returns
    -------
    number of intervals, none of them empty
    """
    count = crossings(lists, first, last, u, v, found)
    if count % 2 == 1:
        for i in range(count, 0, -1):
            found[i] = found[i - 1]
        found[0] = 0.0
        count += 1
    kept = 0
    for i in range(count // 2):
        low, high = found[2 * i], min(reach, found[2 * i + 1])
        if low < high:
            found[2 * kept], found[2 * kept + 1] = low, high
            kept += 1
    return kept


@called
@no_type_check
def list_pieces(mesh, cell, u, v):
    """Write where a ray, 0 <= t <= 1, is inside of each mesh.

    Parameters
    ----------
    mesh : `TracedMeshes`, whose pieces are written
    cell : cell that the ray passes, ``row * columns + column``
    u, v : the ray
    """
    corners, triangles, starts, candidates, found, pieces = mesh
    first, last, ends = pieces
    lists = (corners, triangles, candidates)
    filled = np.int64(0)
    for m in range(starts.shape[0]):
        first[m] = filled
        begin, end = starts[m, cell], starts[m, cell + 1]
        for i in range(intervals(lists, begin, end, u, v, 1.0, found)):
            ends[filled, 0], ends[filled, 1] = found[2 * i], found[2 * i + 1]
            filled += 1
        last[m] = filled


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def project(vertices, matrix, offset, parallel, cells, corners, places):
    """Write the homogeneous coordinates of all vertices, and where they project to.

    Parameters
    ----------
    vertices : (vertex, 3) [mm]
    matrix, offset : rows that give depth, a and b of a point relative to `offset` [mm]
    parallel : whether rays are parallel, so that w = 1
    cells : u and v where the grid of cells begins, and the size of a cell
    corners, places : written: (a, b, w, t) of each vertex; column and row in cells, for w > 0
    """
    for i in range(vertices.shape[0]):
        x, y, z = vertices[i, 0] - offset[0], vertices[i, 1] - offset[1], vertices[i, 2] - offset[2]
        depth = matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2] * z
        a = matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2] * z
        b = matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2] * z
        w = 1.0 if parallel else depth
        corners[i, A], corners[i, B], corners[i, W], corners[i, T] = a, b, w, depth
        places[i, 0] = (a / w - cells[0]) / cells[2]
        places[i, 1] = (b / w - cells[1]) / cells[3]


@inlined
@no_type_check
def span(low, high, count):
    """Compute the cells between two places, with the margin.

    Parameters
    ----------
    low, high : places [cell]
    count : number of cells

    Returns
    -------
    first cell, and the one after the last
    """
    low, high = low - (MARGIN + _RELATIVE * abs(low)), high + (MARGIN + _RELATIVE * abs(high))
    return int(max(0.0, min(count, np.floor(low)))), int(max(0.0, min(count, np.floor(high) + 1.0)))


@inlined
@no_type_check
def clip(x, y, end_x, end_y, low, high, left, right):
    """Widen a range of columns by those of a line, as far as it lies in some rows.

    Parameters
    ----------
    x, y, end_x, end_y : where the line begins and ends [cell]
    low, high : rows
    left, right : the range before

    Returns
    -------
    the range, with slack for rounding
    """
    dx, dy = end_x - x, end_y - y
    begin, end = 0.0, 1.0
    if dy != 0.0:
        begin, end = (low - y) / dy, (high - y) / dy
        if begin > end:
            begin, end = end, begin
        begin, end = max(0.0, begin), min(1.0, end)
    elif not low <= y <= high:
        return left, right
    if begin > end:
        return left, right
    slack = _RELATIVE * (abs(x) + abs(dx))
    x, other = x + begin * dx, x + end * dx
    return min(left, x - slack, other - slack), max(right, x + slack, other + slack)


@inlined
@no_type_check
def _spans_axis(corners, p, q, r, axis, origin, pitch, cell):
    """Whether a triangle that reaches behind the source may be met in a column (axis A) or row (axis B) of cells."""
    slack = MARGIN * pitch + _RELATIVE * (abs(origin) + (cell + 1) * pitch)
    low, high = origin + cell * pitch - slack, origin + (cell + 1) * pitch + slack
    before = corners[p, axis] < low * corners[p, W]
    before = before and corners[q, axis] < low * corners[q, W] and corners[r, axis] < low * corners[r, W]
    behind = corners[p, axis] > high * corners[p, W]
    behind = behind and corners[q, axis] > high * corners[q, W] and corners[r, axis] > high * corners[r, W]
    return not before and not behind


@inlined
@no_type_check
def _enter(starts, candidates, cell, k, listing):
    """Count triangle k in a cell, or write it to the cell's list."""
    if listing:
        candidates[starts[cell]] = k
    starts[cell] += 1


@called
@no_type_check
def _enter_near(corners, triangles, k, cells, columns, starts, candidates, listing):
    """Enter triangle k, which reaches next to the source or behind it, where a row and a column do not exclude it."""
    p, q, r = triangles[k, 0], triangles[k, 1], triangles[k, 2]
    for row in range(starts.size // columns):
        if _spans_axis(corners, p, q, r, B, cells[1], cells[3], row):
            for column in range(columns):
                if _spans_axis(corners, p, q, r, A, cells[0], cells[2], column):
                    _enter(starts, candidates, row * columns + column, k, listing)


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def bin_triangles(mesh, begin, end, cells, columns, starts, candidates, listing):
    """Count the triangles that may be met in each cell, or list them.

    Parameters
    ----------
    mesh : `ProjectedMesh`
    begin, end : range of the triangles
    cells, columns : u and v where the grid begins, size of a cell; number of columns
    starts : per cell, added to: the count, or the place of its next entry in `candidates`
    candidates, listing : indices of triangles, written if `listing`
    """
    corners, places, triangles = mesh
    rows = starts.size // columns
    for k in range(begin, end):
        p, q, r = triangles[k, 0], triangles[k, 1], triangles[k, 2]
        if max(corners[p, W], corners[q, W], corners[r, W]) <= 0.0:
            continue
        if min(corners[p, W], corners[q, W], corners[r, W]) < NEAR:
            _enter_near(corners, triangles, k, cells, columns, starts, candidates, listing)
            continue
        xp, xq, xr = places[p, 0], places[q, 0], places[r, 0]
        yp, yq, yr = places[p, 1], places[q, 1], places[r, 1]
        left, right = span(min(xp, xq, xr), max(xp, xq, xr), columns)
        top, bottom = span(min(yp, yq, yr), max(yp, yq, yr), rows)
        if right - left < 2 or bottom - top < 2 or right - left + bottom - top < 5:
            for row in range(top, bottom):
                for column in range(left, right):
                    _enter(starts, candidates, row * columns + column, k, listing)
            continue
        for row in range(top, bottom):
            low, high = row - MARGIN, row + 1.0 + MARGIN
            least, most = clip(xp, yp, xq, yq, low, high, np.inf, -np.inf)
            least, most = clip(xq, yq, xr, yr, low, high, least, most)
            least, most = clip(xr, yr, xp, yp, low, high, least, most)
            if least > most:
                continue
            left, right = span(least, most, columns)
            for column in range(left, right):
                _enter(starts, candidates, row * columns + column, k, listing)


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def ray_lengths(lists, uv, at, norms, found, out):
    """Write the length inside of a mesh of each ray.

    Parameters
    ----------
    lists : `CellLists` of the mesh
    uv, at : u and v of each ray (ray, 2), and the cell that it passes
    norms : length of each ray [mm]
    found : scratch of `intervals`
    out : lengths [mm], (ray,), written
    """
    corners, triangles, starts, candidates = lists
    mesh = (corners, triangles, candidates)
    for ray in range(uv.shape[0]):
        first, last = starts[at[ray]], starts[at[ray] + 1]
        out[ray] = 0.0
        for i in range(intervals(mesh, first, last, uv[ray, 0], uv[ray, 1], 1.0, found)):
            out[ray] += (found[2 * i + 1] - found[2 * i]) * norms[ray]


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def ray_intervals(lists, uv, at, reach, found, counts, out, writing):
    """Count the intervals of each ray inside of a mesh, and write their ends.

    Parameters
    ----------
    lists, uv, at : as in `ray_lengths`
    reach : t where each ray ends
    found : scratch of `intervals`
    counts : number of intervals of each ray, written
    out, writing : ends of all intervals (interval, 2) divided by `reach`, written if `writing`
    """
    corners, triangles, starts, candidates = lists
    mesh = (corners, triangles, candidates)
    filled = 0
    for ray in range(uv.shape[0]):
        first, last = starts[at[ray]], starts[at[ray] + 1]
        count = intervals(mesh, first, last, uv[ray, 0], uv[ray, 1], reach[ray], found)
        counts[ray] = count
        if writing:
            for i in range(count):
                out[filled + i, 0], out[filled + i, 1] = found[2 * i] / reach[ray], found[2 * i + 1] / reach[ray]
            filled += count


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def ray_crossings(lists, uv, at, found, counts, out, writing):
    """Count the places t > 0 where each ray crosses a mesh, and write them.

    Parameters
    ----------
    lists, uv, at, found : as in `ray_lengths`
    counts : number of places of each ray, written
    out, writing : places t, one ray after the other, written if `writing`
    """
    corners, triangles, starts, candidates = lists
    mesh = (corners, triangles, candidates)
    filled = 0
    for ray in range(uv.shape[0]):
        first, last = starts[at[ray]], starts[at[ray] + 1]
        count = crossings(mesh, first, last, uv[ray, 0], uv[ray, 1], found)
        counts[ray] = count
        if writing:
            for i in range(count):
                out[filled + i] = found[i]
            filled += count


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def count_beyond(lists, uv, at, depths, labels, own, out):
    """Count the crossings t > depth of each line, without those of triangles that have its own label.

    Parameters
    ----------
    lists, uv, at : as in `ray_lengths`
    depths : t of each line beyond which crossings count
    labels, own : label of each triangle, and of each line
    out : numbers of crossings (line,), written
    """
    corners, triangles, starts, candidates = lists
    for ray in range(uv.shape[0]):
        out[ray] = 0
        for i in range(starts[at[ray]], starts[at[ray] + 1]):
            k = candidates[i]
            met, t, _ = meet(corners, triangles, k, uv[ray, 0], uv[ray, 1])
            if met and t > depths[ray] and labels[k] != own[ray]:
                out[ray] += 1


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def mark_overlaps(lists, uv, at, scratch, least, out):
    """Mark where a parallel line enters twice, or leaves twice.

    Parameters
    ----------
    lists : `CellLists` of a mesh in a view whose column step, row step and direction are right-handed
    uv, at : as in `ray_lengths`
    scratch : `OverlapScratch`
    least : shorter overlaps are not marked [t]
    out : (triangle,), set for the second of the two triangles
    """
    corners, triangles, starts, candidates = lists
    found, faces, turns = scratch
    for ray in range(uv.shape[0]):
        count = 0
        for i in range(starts[at[ray]], starts[at[ray] + 1]):
            met, t, turn = meet(corners, triangles, candidates[i], uv[ray, 0], uv[ray, 1])
            if met:
                at_place = count
                while at_place > 0 and found[at_place - 1] > t:
                    found[at_place] = found[at_place - 1]
                    faces[at_place], turns[at_place] = faces[at_place - 1], turns[at_place - 1]
                    at_place -= 1
                found[at_place], faces[at_place], turns[at_place] = t, candidates[i], turn
                count += 1
        within = 0
        for i in range(count):
            within += 1 if turns[i] else -1
            if (within < 0 or within > 1) and found[i + 1] - found[i] > least:
                out[faces[i]] = True
