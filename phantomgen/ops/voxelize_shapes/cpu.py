"""Volume fractions in numba, one column of voxels along z after the other.

A line along z through a column is cut exactly where its owner changes, and the pieces are shared out to the voxels.
Lines average over the column's square: one is enough where centre and corners are cut alike and no silhouette passes;
elsewhere a product Gauss rule, split along the silhouettes where one passes.
"""

from typing import no_type_check

import numpy as np
from numba import njit

from phantomgen.ops.device import called
from phantomgen.ops.mesh.cpu import list_pieces
from phantomgen.ops.silhouette.quadrature import CONICS, may_vanish, shift_form, square_nodes
from phantomgen.ops.silhouette.tiles_cpu import list_active
from phantomgen.ops.trace.cpu import CUT, MATERIAL, PIECE, owned_pieces, set_origin

# Cuts closer than this part of the column's height are the same.
_SAME = 1e-9


@called
@no_type_check
def _cut_line(frame, table, mesh, cell, locals_, u, v, active, count, events):
    """Cut the line through (u, v) in a cell of the column grid; return the number of pieces."""
    x, y = frame[1, 0] + u * frame[2, 0], frame[1, 1] + v * frame[3, 1]
    for i in range(count):
        set_origin(table, locals_, active[i], x, y, frame[1, 2])
    if mesh is None:
        return owned_pieces(table, None, 0.0, 0.0, frame[0, 2], active, count, events)
    list_pieces(mesh, cell, u, v)
    return owned_pieces(table, mesh[5:], 0.0, 0.0, frame[0, 2], active, count, events)


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
def _is_uniform(frame, table, mesh, cell, locals_, ix, iy, active, count, events, other):
    """Whether lines through the corners of a column are cut like that through its centre, and the number of pieces.

    The cuts through the centre are left in `events`.
    """
    pieces = _cut_line(frame, table, mesh, cell, locals_, ix, iy, active, count, events)
    for corner in range(4):
        u, v = ix + (0.499 if corner % 2 else -0.499), iy + (0.499 if corner // 2 else -0.499)
        if _cut_line(frame, table, mesh, cell, locals_, u, v, active, count, other) != pieces:
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
def _gather(forms, roots, firsts, active, count, u, v, local):
    """Collect the conics of the active shapes that cross the column's square; return how many."""
    found = np.int64(0)
    for i in range(count):
        for f in range(firsts[active[i]], firsts[active[i] + 1]):
            shift_form(forms, f, u, v, local, found)
            if may_vanish(local, found):
                local[found, 7] = roots[f]
                found += 1
                if found > CONICS:
                    return found
    return found


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def voxelize_row(frame, table, mesh, locals_, tiles, background, forms, roots, rule, room, scratch, iy, out):
    """Volume fractions of the columns of one row y, (material, z, x).

    Parameters
    ----------
    frame : whole line along z, foot of column (0, 0), step to the next column, step to the next row
    mesh : argument of `list_pieces`, or None
    tiles : fields of `phantomgen.ops.silhouette.tiles.Tiles`
    forms, roots : silhouettes of the shapes seen along z
    rule, room, scratch : Gauss rules; conics, splits, nodes of one column; shapes, events, its fractions
    """
    local, lines, nodes = room
    active, events, other, share = scratch
    rule_nodes, rule_sizes = rule
    materials, voxels, columns = out.shape
    v, start = float(iy), np.int64(0)  # typed, as a literal would compile `square_nodes` a second time
    for ix in range(columns):
        u, cell = float(ix), iy * columns + ix
        for m in range(materials):
            for k in range(voxels):
                share[m, k] = 0.0
        count = list_active(tiles, iy, ix, active)
        conics = _gather(forms, roots, tiles[3], active, count, u, v, local)
        uniform, pieces = _is_uniform(frame, table, mesh, cell, locals_, u, v, active, count, events, other)
        if uniform and conics == 0:
            _share_out(table, events, pieces, 1.0, share)
        else:
            for i in range(square_nodes(local, conics, rule_nodes, rule_sizes, lines, nodes, start)):
                a, b, weight = nodes[i, 0], nodes[i, 1], nodes[i, 2]
                pieces = _cut_line(frame, table, mesh, cell, locals_, u + a, v + b, active, count, events)
                _share_out(table, events, pieces, weight, share)
        for k in range(voxels):
            free = 1.0
            for m in range(materials):
                free -= share[m, k]
            if background >= 0:
                share[background, k] += free
            for m in range(materials):
                out[m, k, ix] = min(1.0, max(0.0, share[m, k]))
