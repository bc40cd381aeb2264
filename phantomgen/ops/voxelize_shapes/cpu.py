"""Volume fractions in numba, one column of voxels along z after the other.

A line along z through a column is cut exactly where its owner changes, and the pieces are shared out to the voxels.
Lines average over the column's square: one is enough where centre and corners are cut alike and no silhouette passes.
Elsewhere a product Gauss rule, split along the silhouettes where one passes, is compared with a weaker one and with
those of the square's quarters, and these with theirs, until the fractions agree: surfaces that slope through a voxel's
top or bottom, edges and meshes leave kinks that no rule sees in advance.
"""

from typing import no_type_check

import numpy as np
from numba import njit

from phantomgen.ops.kernel_decorators import called
from phantomgen.ops.mesh.cpu import list_pieces
from phantomgen.ops.silhouette.quadrature import CONICS, may_vanish, shift_form, square_nodes
from phantomgen.ops.silhouette.tiles_cpu import list_active
from phantomgen.ops.trace.cpu import CUT, PIECE, owned_pieces
from phantomgen.ops.trace.table import MATERIAL, set_origin

# A square of a column is quartered until its fractions change by less than this, in parts of the square's side, or
# until it is this small: errors of squares along a kink have either sign.
TOLERANCE = 3e-4
SMALLEST = 1 / 16
STACK = 18
# Cuts closer than this part of the column's height are the same.
_SAME = 1e-9


def stack(materials: int, voxels: int):
    """Room for squares of a column, and for their fractions."""
    return np.empty((STACK, 3)), np.empty((STACK, materials, voxels))


@called
@no_type_check
def _cut_line(frame, table, tubes, mesh, cell, u, v, active, count, events):
    """Cut the line through (u, v) in a cell of the column grid; return the number of pieces."""
    x, y = frame[1, 0] + u * frame[2, 0], frame[1, 1] + v * frame[3, 1]
    for i in range(count):
        set_origin(table, active[i], x, y, frame[1, 2])
    if mesh is None:
        return owned_pieces(table, tubes, None, 0.0, 0.0, frame[0, 2], active, count, events)
    list_pieces(mesh, cell, u, v)
    return owned_pieces(table, tubes, mesh[5:], 0.0, 0.0, frame[0, 2], active, count, events)


@called
@no_type_check
def _share_out(table, events, pieces, weight, share):
    """Add `weight` times the length of each piece, in voxels, to the voxels of ``share[material]``."""
    voxels = share.shape[1]
    for i in range(pieces):
        owner = int(events[PIECE, i])
        if owner < 0:
            continue
        material = int(table[owner, MATERIAL])
        low, high = events[CUT, i] * voxels, events[CUT, i + 1] * voxels
        for k in range(int(low), min(voxels, int(high) + 1)):
            share[material, k] += weight * max(0.0, min(high, k + 1.0) - max(low, float(k)))


@called
@no_type_check
def _is_uniform(frame, table, tubes, mesh, cell, ix, iy, active, count, events, other):
    """Whether lines through the corners of a column are cut like that through its centre, and the number of pieces.

    The cuts through the centre are left in `events`.
    """
    pieces = _cut_line(frame, table, tubes, mesh, cell, ix, iy, active, count, events)
    for corner in range(4):
        u, v = ix + (0.499 if corner % 2 else -0.499), iy + (0.499 if corner // 2 else -0.499)
        if _cut_line(frame, table, tubes, mesh, cell, u, v, active, count, other) != pieces:
            return False, pieces
        for i in range(pieces):
            if events[PIECE, i] != other[PIECE, i]:
                return False, pieces
            for j in range(i, i + 2):
                if abs(events[CUT, j] - other[CUT, j]) > _SAME:
                    return False, pieces
    return True, pieces


@called
@no_type_check
def _gather(forms, roots, firsts, active, count, square, local):
    """Collect the conics of the active shapes that cross a square of a column, relative to it; return how many."""
    u, v, side = square
    found = np.int64(0)
    for i in range(count):
        for f in range(firsts[active[i]], firsts[active[i] + 1]):
            shift_form(forms, f, u, v, local, found)
            for power in range(1, 6):
                local[found, power] *= side if power < 3 else side * side
            if may_vanish(local, found):
                local[found, 7] = roots[f]
                found += 1
                if found > CONICS:
                    return found
    return found


@called
@no_type_check
def _clear(share):
    """``share[:] = 0``, by loops like the next two: for whole arrays numba compiles seconds of checks."""
    for m in range(share.shape[0]):
        for k in range(share.shape[1]):
            share[m, k] = 0.0


@called
@no_type_check
def _copy(share, other):
    """``share[:] = other``."""
    for m in range(share.shape[0]):
        for k in range(share.shape[1]):
            share[m, k] = other[m, k]


@called
@no_type_check
def _add(share, other):
    """``share += other``."""
    for m in range(share.shape[0]):
        for k in range(share.shape[1]):
            share[m, k] += other[m, k]


@called
@no_type_check
def _estimate(view, level, room, active, count, events, square, share):
    """Fractions that a square (u, v, side) of a column adds to its voxels, by one Gauss rule split along the conics."""
    frame, table, tubes, mesh, cell, forms, roots, firsts, rules = view
    local, lines, nodes = room
    u, v, side = square
    _clear(share)
    conics, start = _gather(forms, roots, firsts, active, count, square, local), np.int64(0)
    for i in range(square_nodes(local, conics, rules[0][level], rules[1][level], lines, nodes, start)):
        a, b, weight = u + side * nodes[i, 0], v + side * nodes[i, 1], side * side * nodes[i, 2]
        pieces = _cut_line(frame, table, tubes, mesh, cell, a, b, active, count, events)
        _share_out(table, events, pieces, weight, share)


@called
@no_type_check
def _disagree(shares, top, limit):
    """Whether the estimates of a square by two rules differ from the sum of those of its quarters, in this order."""
    for m in range(shares.shape[1]):
        for k in range(shares.shape[2]):
            quarters = shares[top + 2, m, k] + shares[top + 3, m, k] + shares[top + 4, m, k] + shares[top + 5, m, k]
            if abs(quarters - shares[top, m, k]) > limit or abs(quarters - shares[top + 1, m, k]) > limit:
                return True
    return False


@called
@no_type_check
def _average(view, room, active, count, events, square, squares, shares, share):
    """Fractions of a column, its squares quartered until they agree with another rule and with their quarters.

    `squares` and `shares` are a stack of squares (u, v, side) and of their estimates. Two rules and the quarters must
    agree, as any two of them do by chance for some kinks.
    """
    top, strong, weak = 0, np.int64(0), np.int64(1)  # typed, as literals would compile `_estimate` once for each
    squares[0, 0], squares[0, 1], squares[0, 2] = square[0], square[1], square[2]
    _estimate(view, strong, room, active, count, events, square, shares[0])
    while top >= 0:
        x, y, side = squares[top, 0], squares[top, 1], squares[top, 2]
        _estimate(view, weak, room, active, count, events, (x, y, side), shares[top + 1])
        for quarter in range(4):
            at, step = top + 2 + quarter, 0.25 * side
            part = (x + (step if quarter % 2 else -step), y + (step if quarter // 2 else -step), 0.5 * side)
            squares[at, 0], squares[at, 1], squares[at, 2] = part[0], part[1], part[2]
            _estimate(view, strong, room, active, count, events, part, shares[at])
        if side > SMALLEST and _disagree(shares, top, TOLERANCE * side):
            for i in range(top, top + 2):
                for k in range(3):
                    squares[i, k] = squares[i + 4, k]
                _copy(shares[i], shares[i + 4])
            top += 3
        else:
            for i in range(top + 2, top + 6):
                _add(share, shares[i])
            top -= 1


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def voxelize_row(frame, table, tubes, mesh, tiles, background, forms, roots, rules, room, scratch, iy, out):
    """Volume fractions of the columns of one row y, (material, z, x).

    Parameters
    ----------
    frame : whole line along z, foot of column (0, 0), step to the next column, step to the next row
    mesh : argument of `list_pieces`, or None
    tiles : fields of `phantomgen.ops.silhouette.tiles.Tiles`
    forms, roots : silhouettes of the shapes seen along z
    rules, room : two Gauss rules; conics, splits and nodes of one square
    scratch : shapes, events twice, stack of squares and of their fractions, fractions of a column
    """
    active, events, other, squares, shares, share = scratch
    materials, voxels, columns = out.shape
    v = float(iy)
    for ix in range(columns):
        u, cell = float(ix), iy * columns + ix
        _clear(share)
        count = list_active(tiles, iy, ix, active)
        conics = _gather(forms, roots, tiles[3], active, count, (u, v, 1.0), room[0])
        uniform, pieces = _is_uniform(frame, table, tubes, mesh, cell, u, v, active, count, events, other)
        if uniform and conics == 0:
            _share_out(table, events, pieces, 1.0, share)
        else:
            view = (frame, table, tubes, mesh, cell, forms, roots, tiles[3], rules)
            _average(view, room, active, count, events, (u, v, 1.0), squares, shares, share)
        for k in range(voxels):
            free = 1.0
            for m in range(materials):
                free -= share[m, k]
            if background >= 0:
                share[background, k] += free
            for m in range(materials):
                out[m, k, ix] = min(1.0, max(0.0, share[m, k]))
