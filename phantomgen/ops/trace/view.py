"""Path lengths of the rays through all pixels' centres of a view, in numba.

Where shapes lie apart from each other or inside each other along a ray, the later one inside, the length of each is
that of its chord, less the chords of what lies inside it. That needs no sorted events, and suffices for most rays of
most scenes; the others are cut where their owner changes, as in `phantomgen.ops.trace.cpu`.
"""

from math import sqrt
from typing import no_type_check

from numba import njit

from phantomgen.ops.kernel_decorators import inlined
from phantomgen.ops.silhouette.tiles_cpu import list_active
from phantomgen.ops.trace.cpu import ENTER, HIT, LEAVE, add_pieces, collect, cut_pieces
from phantomgen.ops.trace.table import MATERIAL, set_origin


@inlined
@no_type_check
def _add_nested(table, background, norm, hits, events, lengths):
    """Write path lengths of a ray whose shapes are disjoint or nested along it; return whether they are."""
    for m in range(lengths.size):
        lengths[m] = 0.0
    free = norm
    for i in range(hits):
        enter, leave, within = events[ENTER, i], events[LEAVE, i], -1
        for j in range(i):
            if events[ENTER, j] < leave and events[LEAVE, j] > enter:
                if events[ENTER, j] > enter or events[LEAVE, j] < leave:
                    return False
                within = j
        part = (leave - enter) * norm
        lengths[int(table[int(events[HIT, i]), MATERIAL])] += part
        if within >= 0:
            lengths[int(table[int(events[HIT, within]), MATERIAL])] -= part
        else:
            free -= part
    if background >= 0:
        lengths[background] += free
    return True


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def trace_pixels(frame, solids, tiles, whole, scratch, lengths, out):
    """Write the path lengths of a view.

    Parameters
    ----------
    frame : source, vector from there to the centre of pixel (0, 0), column step, row step [mm]
    solids : `TracedSolids` without meshes and voxel maps; its table gets the source as origin
    tiles : `phantomgen.ops.silhouette.tiles.Tiles` of the panel
    whole : whether every object is one primitive
    scratch, lengths : `RayScratch`; memory for the path lengths of one ray (material,)
    out : path lengths [mm], (row, column, material), written
    """
    table, tubes, _, background = solids
    active, events = scratch
    for s in range(table.shape[0]):
        set_origin(table, s, frame[0, 0], frame[0, 1], frame[0, 2])
    for row in range(out.shape[0]):
        for column in range(out.shape[1]):
            count = list_active(tiles, row, column, active)
            if count == 0 and background < 0:
                for m in range(lengths.size):
                    out[row, column, m] = 0.0
                continue
            dx = frame[1, 0] + column * frame[2, 0] + row * frame[3, 0]
            dy = frame[1, 1] + column * frame[2, 1] + row * frame[3, 1]
            dz = frame[1, 2] + column * frame[2, 2] + row * frame[3, 2]
            direction = (dx, dy, dz)
            hits, norm = (
                collect(table, tubes, None, direction, active, count, events),
                sqrt(dx * dx + dy * dy + dz * dz),
            )
            if not whole or not _add_nested(table, background, norm, hits, events, lengths):
                pieces = cut_pieces(table, hits, events)
                add_pieces(table, None, background, direction, pieces, events, lengths)
            for m in range(lengths.size):
                out[row, column, m] = lengths[m]
