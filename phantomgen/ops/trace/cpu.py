"""Exact path lengths in numba, one ray after the other.

A ray is ``origin + t direction``, 0 <= t <= 1. `owned_pieces` and `add_pieces` are what other kernels call; the origin
comes in local coordinates, because many rays share one.
"""

from math import sqrt
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float, Int64
from numba import njit

from phantomgen.ops.kernel_decorators import called, inlined
from phantomgen.ops.primitives import BALL, BOX, CONE, CYLINDER, HALFSPACE, MESH
from phantomgen.ops.trace.grazing import grazing_discriminant
from phantomgen.ops.trace.table import ALONE, KIND, MATERIAL, NEAR, NEED, OWNER, SURFACE, TERM, set_origin
from phantomgen.ops.trace.torus import torus_intervals
from phantomgen.ops.trace.voxels import add_map

# Rows of the scratch for the events along one ray. Cut i is the end ``events[END, i]`` of a hit: its number times two,
# plus one where the ray leaves. `OPEN` lists the hits that the ray has entered and not left.
ENTER, LEAVE, HIT, CUT, PIECE, END, OPEN, EXACT, EVENT_ROWS = 0, 1, 2, 3, 4, 5, 6, 6, 7
# Bits of a signature that tell the order of what a ray passes; the others tell what it meets at all.
ORDER = 0xFFFFFFFF


class RayScratch(NamedTuple):
    """Scratch memory of the kernels for one ray.

    Parameters
    ----------
    active : rows of the primitives that the ray may meet
    events : what happens along the ray; its rows are named by `ENTER` to `OPEN`
    """

    active: Int64[np.ndarray, " row"]
    events: Float[np.ndarray, "7 event"]

    @classmethod
    def of(cls, rows: int, pieces: int = 0) -> "RayScratch":
        """Allocate scratch memory for a ray that meets all primitives, and each torus twice.

        Parameters
        ----------
        rows : number of primitives
        pieces : most pieces of a ray that lie in meshes

        Returns
        -------
        arrays without values
        """
        return cls(np.empty(rows, np.int64), np.empty((EVENT_ROWS, 4 * rows + 2 * pieces + 1)))


@inlined
@no_type_check
def _slab(position, slope, first, last):
    """Part of ``first <= t <= last`` where ``-1 <= position + t slope < 1``."""
    if slope == 0.0:
        return (first, last) if -1.0 <= position < 1.0 else (1.0, 0.0)
    low, high = (-1.0 - position) / slope, (1.0 - position) / slope
    if low > high:
        low, high = high, low
    return max(first, low), min(last, high)


@inlined
@no_type_check
def _between_roots(a, b, discriminant, inside):
    """Interval where ``a t^2 + 2 b t + c < 0``; without curvature (a = 0) everything or nothing."""
    if a == 0.0:
        return (0.0, 1.0) if inside else (1.0, 0.0)
    if discriminant <= 0.0:
        return 1.0, 0.0
    root = sqrt(discriminant)
    return max(0.0, (-b - root) / a), min(1.0, (-b + root) / a)


@inlined
@no_type_check
def _in_cone(origin, direction, discriminant):
    """Interval inside the upper half of the double cone ``x^2 + y^2 < z^2``, cut off at its base."""
    ox, oy, oz = origin
    dx, dy, dz = direction
    a, b = dx * dx + dy * dy - dz * dz, ox * dx + oy * dy - oz * dz
    first, last = _slab(2.0 * oz - 1.0, 2.0 * dz, 0.0, 1.0)
    if a == 0.0:
        if b == 0.0:
            return (1.0, 0.0) if ox * ox + oy * oy >= oz * oz else (first, last)
        end = (oz * oz - ox * ox - oy * oy) / (2.0 * b)
        return (first, min(last, end)) if b > 0.0 else (max(first, end), last)
    if a > 0.0 and discriminant <= 0.0:
        return 1.0, 0.0
    root = sqrt(max(discriminant, 0.0))
    low, high = (-b - root) / a, (-b + root) / a
    if a > 0.0:
        return max(first, low), min(last, high)
    # Steeper than the mantle: outside the roots, of which one lies on the other half of the double cone.
    return (max(first, low), last) if dz > 0.0 else (first, min(last, high))


@inlined
@no_type_check
def _round_chord(kind, origin, direction, near, refined, exact):
    """Interval inside a ball, a cylinder or a cone, and whether the ray almost misses it.

    Discriminants stand as squares of the direction minus squares of the moment ``o x d`` (Lagrange's identity), which
    keeps the digits that ``b^2 - a c`` loses for a distant source. Where a ray almost misses, these are too inexact as
    well: there the `exact` one is taken, once it is known.
    """
    ox, oy, oz = origin
    dx, dy, dz = direction
    across, along, mz = dx * dx + dy * dy, dz * dz, ox * dy - oy * dx
    if kind == CYLINDER:
        discriminant = across - mz * mz
    else:
        mx, my = oy * dz - oz * dy, oz * dx - ox * dz
        turned = mx * mx + my * my
        discriminant = across + along - turned - mz * mz if kind == BALL else turned - mz * mz
    grazing = abs(discriminant) < near * (across + along)
    if grazing and refined:
        discriminant = exact
    if kind == BALL:
        inside = ox * ox + oy * oy + oz * oz < 1.0
        first, last = _between_roots(across + along, ox * dx + oy * dy + oz * dz, discriminant, inside)
    elif kind == CONE:
        first, last = _in_cone(origin, direction, discriminant)
    else:
        first, last = _between_roots(across, ox * dx + oy * dy, discriminant, ox * ox + oy * oy < 1.0)
        first, last = _slab(oz, dz, first, last)
    return first, last, grazing


@inlined
@no_type_check
def _halfspace_chord(oz, dz):
    """Interval inside a half-space."""
    if dz == 0.0:
        return (0.0, 1.0) if oz < 0.0 else (1.0, 0.0)
    cut = -oz / dz
    return (0.0, min(1.0, cut)) if dz > 0.0 else (max(0.0, cut), 1.0)


@inlined
@no_type_check
def _box_chord(origin, direction):
    """Interval inside a box."""
    first, last = _slab(origin[0], direction[0], 0.0, 1.0)
    first, last = _slab(origin[1], direction[1], first, last)
    return _slab(origin[2], direction[2], first, last)


@called
@no_type_check
def _refine(table, direction, active, count, events):
    """Write discriminants of the active primitives in twice the precision; flat ones have none, only a number."""
    for i in range(count):
        events[EXACT, i] = grazing_discriminant(table[active[i]], direction)


@inlined
@no_type_check
def collect(table, tubes, listed, direction, active, count, events):
    """Write where the ray meets the active primitives to `events`, in the order of these.

    Parameters
    ----------
    table, tubes : primitives as `solid_table` makes them, with the ray's origin filled in; as `ring_tubes` does
    listed : first and last piece of each mesh that the ray runs in, and their ends (piece, 2); None without meshes
    direction : from the ray's start to its end (x, y, z) [mm]
    active, count : rows that the ray may meet, ascending; number of these
    events : rows `ENTER`, `LEAVE` and `HIT` are written

    Returns
    -------
    number of hits
    """
    dx, dy, dz = direction
    refined = False
    while True:
        hits, grazing = 0, False
        for i in range(count):
            s = active[i]
            kind = table[s, KIND]
            if listed is not None:
                first_piece, last_piece, ends = listed
                if kind == MESH:
                    mesh = int(table[s, SURFACE])
                    for piece in range(first_piece[mesh], last_piece[mesh]):
                        events[ENTER, hits], events[LEAVE, hits], events[HIT, hits] = ends[piece, 0], ends[piece, 1], s
                        hits += 1
                    continue
            origin = (table[s, 2], table[s, 3], table[s, 4])
            lx = table[s, 5] * dx + table[s, 6] * dy + table[s, 7] * dz
            ly = table[s, 8] * dx + table[s, 9] * dy + table[s, 10] * dz
            lz = table[s, 11] * dx + table[s, 12] * dy + table[s, 13] * dz
            way = (lx, ly, lz)
            if tubes is not None and tubes[s] > 0.0:
                hits += torus_intervals(tubes[s], origin, way, s, hits, events)
                continue
            if kind == BOX:
                first, last = _box_chord(origin, way)
            elif kind == HALFSPACE:
                first, last = _halfspace_chord(origin[2], lz)
            else:
                first, last, close = _round_chord(kind, origin, way, table[s, NEAR], refined, events[EXACT, i])
                grazing |= close
            if first < last:
                events[ENTER, hits] = first
                events[LEAVE, hits] = last
                events[HIT, hits] = s
                hits += 1
        if refined or not grazing:
            return hits
        # The few rays that graze are computed twice: a call inside the loop above would slow down all others.
        _refine(table, direction, active, count, events)
        refined = True


@inlined
@no_type_check
def _owner(table, events, count):
    """First row of the last object that covers the ray where `count` hits are open; -1: none does."""
    i = count - 1
    while i >= 0:
        s = int(events[HIT, int(events[OPEN, i])])
        if table[s, ALONE] > 0.0:
            return table[s, OWNER]
        term, met, need = table[s, TERM], 0, 1
        while i >= 0:
            row = int(events[HIT, int(events[OPEN, i])])
            if table[row, TERM] != term:
                break
            if table[row, NEED] > 0.0:
                need = int(table[row, NEED])
                met += 1
            else:
                met = -count  # outside is wanted: never enough
            i -= 1
        if met == need:
            return table[s, OWNER]
    return -1.0


@inlined
@no_type_check
def _sort_cuts(events, hits):
    """Write all ends of the hits to the row of cuts, ascending, and whose ends they are."""
    for i in range(2 * hits):
        value = events[i % 2, i // 2]
        at = i
        while at > 0 and events[CUT, at - 1] > value:
            events[CUT, at], events[END, at] = events[CUT, at - 1], events[END, at - 1]
            at -= 1
        events[CUT, at], events[END, at] = value, i


@inlined
@no_type_check
def _pass_end(events, end, count):
    """Open or close the hit whose end the ray passes; open hits stay in ascending order. Return their number."""
    hit, at = end // 2, count
    if end % 2 == 0:
        while at > 0 and events[OPEN, at - 1] > hit:
            events[OPEN, at] = events[OPEN, at - 1]
            at -= 1
        events[OPEN, at] = hit
        return count + 1
    while events[OPEN, at - 1] != hit:
        at -= 1
    for i in range(at, count):
        events[OPEN, i - 1] = events[OPEN, i]
    return count - 1


@inlined
@no_type_check
def owned_pieces(table, tubes, listed, direction, active, count, events):
    """Cut the ray where its owner changes.

    Parameters
    ----------
    table, tubes, listed, direction, active, count : as in `collect`
    events : written as by `cut_pieces`

    Returns
    -------
    number of pieces; 0 for a ray that meets nothing
    """
    hits = collect(table, tubes, listed, direction, active, count, events)
    return cut_pieces(table, hits, events)


@inlined
@no_type_check
def cut_pieces(table, hits, events):
    """Cut the ray where its owner changes, by the hits that `collect` has written.

    Afterwards the object that begins with row ``events[PIECE, i]`` owns the ray from ``events[CUT, i]``, where it meets
    row ``events[END, i]``, to ``events[CUT, i + 1]``, where it meets row ``events[END, i + 1]``; -1: no object owns it.

    Parameters
    ----------
    table : as in `collect`
    hits : number of hits
    events : all rows are written; the primitives that the ray meets are ``events[HIT]`` up to a -1

    Returns
    -------
    number of pieces; 0 for a ray that meets nothing
    """
    if hits == 0:
        return 0
    events[HIT, hits] = -1.0
    _sort_cuts(events, hits)
    pieces = count = 0
    for i in range(2 * hits - 1):
        count = _pass_end(events, int(events[END, i]), count)
        low, high = events[CUT, i], events[CUT, i + 1]
        if high <= low:
            continue
        owner, met = _owner(table, events, count), events[HIT, int(events[END, i]) // 2]
        if pieces > 0 and events[PIECE, pieces - 1] == owner:
            events[CUT, pieces] = high
        else:
            events[PIECE, pieces], events[END, pieces] = owner, met
            events[CUT, pieces], events[CUT, pieces + 1] = low, high
            pieces += 1
    events[END, pieces] = events[HIT, int(events[END, 2 * hits - 1]) // 2]
    return pieces


@inlined
@no_type_check
def add_pieces(table, maps, background, direction, pieces, events, lengths):
    """Write the path length per material of one ray that `owned_pieces` has cut into pieces.

    Kernels call the two one after the other: with both inside a third function, a ray takes 30 ns more.

    Parameters
    ----------
    table : as in `collect`
    maps : `VoxelMaps`; None without voxel maps
    background : material of what no shape owns, -1 for none
    direction : as in `collect` [mm]
    pieces, events : result of `owned_pieces`, and what it has written
    lengths : path lengths [mm], (material,), written

    Returns
    -------
    signature of the ray, 0 for one that meets nothing. Its bits `ORDER` name the owners along the ray in turn, and the
    shapes whose surfaces separate them; the other bits name the rows that the ray meets, which change at silhouettes
    only.
    """
    dx, dy, dz = direction
    for m in range(lengths.size):
        lengths[m] = 0.0
    norm = sqrt(dx * dx + dy * dy + dz * dz)
    signature = 0
    covered = 0.0
    for i in range(pieces):
        owner = int(events[PIECE, i])
        signature = signature * 1000003 + owner + 2 + (int(events[END, i]) << 32)
        if owner >= 0:
            if maps is not None and maps.numbers[owner] >= 0:
                low, high = events[CUT, i], events[CUT, i + 1]
                covered += add_map(maps, table, owner, direction, low, high, norm, lengths)
                continue
            part = (events[CUT, i + 1] - events[CUT, i]) * norm
            lengths[int(table[owner, MATERIAL])] += part
            covered += part
    if background >= 0:
        lengths[background] += norm - covered
    if pieces > 0:
        # Surfaces that source or panel cut off are told from those that the ray passes.
        signature = 1000003 * signature + (int(events[END, pieces]) << 32)
        signature = 4 * signature + (events[CUT, 0] > 0.0) + 2 * (events[CUT, pieces] < 1.0)
        signature = _with_rows(signature, events)
    return signature


@inlined
@no_type_check
def _with_rows(signature, events):
    """Signature in the lower half of a number whose upper half names the rows that the ray meets, hidden or not."""
    met = i = 0
    while events[HIT, i] >= 0.0:
        row = int(events[HIT, i]) + 1
        met += row * (row + 7) * 2654435761
        i += 1
    return ((met ^ (met >> 29)) << 32) | ((signature ^ (signature >> 32)) & ORDER)


@inlined
@no_type_check
def _list_near(balls, origin, direction, active):
    """Write the rows whose balls the line meets to `active`, ascending; return how many."""
    ox, oy, oz = origin
    dx, dy, dz = direction
    count = 0
    reach = (1.0 + 1e-9) * (dx * dx + dy * dy + dz * dz)
    for s in range(balls.shape[0]):
        x, y, z = balls[s, 0] - ox, balls[s, 1] - oy, balls[s, 2] - oz
        mx, my, mz = y * dz - z * dy, z * dx - x * dz, x * dy - y * dx
        active[count] = s
        count += mx * mx + my * my + mz * mz <= reach * balls[s, 3]
    return count


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def trace_rays(solids, listed, balls, origins, directions, scratch, out):
    """Write the path length per material of many rays.

    Parameters
    ----------
    solids : `TracedSolids`
    listed : where the pieces of each mesh and ray start (mesh, ray + 1), and their ends (piece, 2); None without meshes
    balls : around the primitives: centre and radius squared (row, 4); with none of them, rays test all rows
    origins, directions : start of each ray, and the vector from there to its end (ray, 3) [mm]
    scratch : `RayScratch`
    out : path lengths [mm], (ray, material), written
    """
    table, tubes, maps, background = solids
    active, events = scratch
    for s in range(table.shape[0]):
        active[s] = s
    for ray in range(directions.shape[0]):
        origin = (origins[ray, 0], origins[ray, 1], origins[ray, 2])
        direction = (directions[ray, 0], directions[ray, 1], directions[ray, 2])
        count = active.size
        if balls.shape[0] > 0:
            count = _list_near(balls, origin, direction, active)
        for i in range(count):
            set_origin(table, active[i], origin[0], origin[1], origin[2])
        if listed is None:
            pieces = owned_pieces(table, tubes, None, direction, active, count, events)
        else:
            starts, ends = listed
            own = (starts[:, ray], starts[:, ray + 1], ends)
            pieces = owned_pieces(table, tubes, own, direction, active, count, events)
        add_pieces(table, maps, background, direction, pieces, events, out[ray])
