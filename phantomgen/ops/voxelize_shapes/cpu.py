"""Volume fractions in numba, one column of voxels along z after the other.

A line along z through a column is cut exactly where its owner changes, and the pieces are shared out to the voxels.
Lines average over the column's square: one is enough where centre and corners are cut alike and no silhouette passes.
Elsewhere a product Gauss rule, split along the silhouettes where one passes, is compared with a weaker one and with
those of the square's quarters, and these with theirs, until the fractions agree: surfaces that slope through a voxel's
top or bottom, edges and meshes leave kinks that no rule sees in advance.
"""

from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float
from numba import njit

from phantomgen.ops.kernel_decorators import called
from phantomgen.ops.mesh.cpu import TracedMeshes, list_pieces
from phantomgen.ops.silhouette.forms import Silhouettes
from phantomgen.ops.silhouette.quadrature import CONICS, Room, Rules, make_room, may_vanish, shift_form, square_nodes
from phantomgen.ops.silhouette.tiles import Tiles
from phantomgen.ops.silhouette.tiles_cpu import list_active
from phantomgen.ops.trace.cpu import CUT, PIECE, RayScratch, owned_pieces
from phantomgen.ops.trace.table import MATERIAL, TracedSolids, set_origin

# A square of a column is quartered until its fractions change by less than `TOLERANCE` [voxel], in parts of the
# square's side, or until its side is `SMALLEST` [width of a column]: errors of squares along a kink have either sign.
# Measured errors are some 1e-4 of a voxel (`benchmarks/operators/volume_fractions.py`).
TOLERANCE = 3e-4
SMALLEST = 1 / 16
# Squares that wait at a time: six, and three more each time that the side is halved to `SMALLEST`.
STACK = 18
# Part of the column's height, no unit; cuts that are closer than this are the same: far above rounding, 1e-16.
_SAME = 1e-9
# Offset of the lines near the corners of a column [width of a column]: just within its square, so that they do not run
# in faces on its border.
_CORNER = 0.499


class Columns(NamedTuple):
    """Objects as seen along z through a grid of voxel columns.

    Parameters
    ----------
    frame : whole line along z, foot of column (0, 0), step to the next column, step to the next row [mm]
    solids : the objects, whose table gets the origin of lines
    mesh : closed meshes among them; None without any
    tiles : which objects may be met in which part of the grid
    outline : silhouettes of the objects seen along z
    rules : two Gauss rules, the stronger one first
    """

    frame: Float[np.ndarray, "4 3"]
    solids: TracedSolids
    mesh: TracedMeshes | None
    tiles: Tiles
    outline: Silhouettes
    rules: Rules


class ColumnScratch(NamedTuple):
    """Scratch memory for one column.

    Parameters
    ----------
    line : for the line through the centre
    other : for events along another line, like those of `line`
    room : for one square that silhouettes cross
    squares : stack of squares (u, v, side)
    shares : fractions of each of these
    share : fractions of the column
    """

    line: RayScratch
    other: Float[np.ndarray, "7 event"]
    room: Room
    squares: Float[np.ndarray, "square 3"]
    shares: Float[np.ndarray, "square material z"]
    share: Float[np.ndarray, "material z"]

    @classmethod
    def of(cls, rules: Rules, line: RayScratch, materials: int, voxels: int) -> "ColumnScratch":
        """Allocate the memory.

        Parameters
        ----------
        rules : Gauss rules
        line : scratch memory for one line
        materials, voxels : number of materials, and of voxels of a column

        Returns
        -------
        arrays without values
        """
        shares = np.empty((STACK, materials, voxels))
        other, share = np.empty_like(line.events), np.empty((materials, voxels))
        return cls(line, other, make_room(rules), np.empty((STACK, 3)), shares, share)


@called
@no_type_check
def _cut_line(solids, mesh, cell, u, v, active, count, events):
    """Cut the line through (u, v) in a cell of the column grid; return the number of pieces.

    `solids` are the frame, table and tubes of the view, without its other arrays, whose references numba would count
    in every call. `mesh` is an argument, as numba leaves out a branch for None only where an argument is None.
    """
    frame, table, tubes = solids
    x, y = frame[1, 0] + u * frame[2, 0], frame[1, 1] + v * frame[3, 1]
    for i in range(count):
        set_origin(table, active[i], x, y, frame[1, 2])
    direction = (0.0, 0.0, frame[0, 2])
    if mesh is None:
        return owned_pieces(table, tubes, None, direction, active, count, events)
    list_pieces(mesh, cell, u, v)
    return owned_pieces(table, tubes, mesh.pieces, direction, active, count, events)


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
def _is_uniform(view, cell, ix, iy, scratch, count):
    """Whether lines near the corners of a column are cut like that through its centre, and the number of pieces.

    The cuts through the centre are left in the events of ``scratch.line``.
    """
    (active, events), other = scratch.line, scratch.other
    solids = (view.frame, view.solids.table, view.solids.tubes)
    pieces = _cut_line(solids, view.mesh, cell, ix, iy, active, count, events)
    for corner in range(4):
        u, v = ix + (_CORNER if corner % 2 else -_CORNER), iy + (_CORNER if corner // 2 else -_CORNER)
        if _cut_line(solids, view.mesh, cell, u, v, active, count, other) != pieces:
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
def _gather(view, active, count, square, local):
    """Collect the conics of the active shapes that cross a square of a column, relative to it; return how many."""
    forms, roots, firsts = view.outline.forms, view.outline.roots, view.tiles.firsts
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
    """``share[:] = 0``, by loops like the next two functions: for whole arrays, numba would compile for seconds."""
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
def _estimate(view, cell, level, scratch, count, square, share):
    """Fractions that a square (u, v, side) of a column adds to its voxels, by one Gauss rule split along the conics."""
    (active, events), (local, lines, nodes), table = scratch.line, scratch.room, view.solids.table
    rule_nodes, rule_sizes = view.rules.nodes[level], view.rules.sizes[level]
    solids, (u, v, side) = (view.frame, table, view.solids.tubes), square
    _clear(share)
    conics, start = _gather(view, active, count, square, local), np.int64(0)
    for i in range(square_nodes(local, conics, rule_nodes, rule_sizes, lines, nodes, start)):
        a, b, weight = u + side * nodes[i, 0], v + side * nodes[i, 1], side * side * nodes[i, 2]
        pieces = _cut_line(solids, view.mesh, cell, a, b, active, count, events)
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
def _average(view, cell, scratch, count, square):
    """Fractions of a column, its squares quartered until they agree with another rule and with their quarters.

    Two rules and the quarters must agree, as any two of them do by chance for some kinks.
    """
    squares, shares, share = scratch.squares, scratch.shares, scratch.share
    top, strong, weak = 0, np.int64(0), np.int64(1)  # typed, as literals would compile `_estimate` once for each
    squares[0, 0], squares[0, 1], squares[0, 2] = square[0], square[1], square[2]
    _estimate(view, cell, strong, scratch, count, square, shares[0])
    while top >= 0:
        x, y, side = squares[top, 0], squares[top, 1], squares[top, 2]
        _estimate(view, cell, weak, scratch, count, (x, y, side), shares[top + 1])
        for quarter in range(4):
            at, step = top + 2 + quarter, 0.25 * side
            part = (x + (step if quarter % 2 else -step), y + (step if quarter // 2 else -step), 0.5 * side)
            squares[at, 0], squares[at, 1], squares[at, 2] = part[0], part[1], part[2]
            _estimate(view, cell, strong, scratch, count, part, shares[at])
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
def voxelize_rows(view, scratch, first, out):
    """Write the volume fractions of the columns of some rows y.

    Parameters
    ----------
    view : `Columns`
    scratch : `ColumnScratch`
    first : first row
    out : fractions (material, z, y, x) of these rows, written
    """
    table, background = view.solids.table, view.solids.background
    (active, events), share = scratch.line, scratch.share
    materials, voxels, rows, columns = out.shape
    for row in range(rows):
        iy = first + row
        v = float(iy)
        for ix in range(columns):
            u, cell = float(ix), iy * columns + ix
            _clear(share)
            count = list_active(view.tiles, iy, ix, active)
            conics = _gather(view, active, count, (u, v, 1.0), scratch.room.local)
            uniform, pieces = _is_uniform(view, cell, u, v, scratch, count)
            if uniform and conics == 0:
                _share_out(table, events, pieces, 1.0, share)
            else:
                _average(view, cell, scratch, count, (u, v, 1.0))
            for k in range(voxels):
                free = 1.0
                for m in range(materials):
                    free -= share[m, k]
                if background >= 0:
                    share[background, k] += free
                for m in range(materials):
                    out[m, k, row, ix] = min(1.0, max(0.0, share[m, k]))
