"""Shapes near a cell of a panel, in numba."""

from typing import no_type_check

import numpy as np

from phantomgen.ops.kernel_decorators import inlined
from phantomgen.ops.silhouette.tiles import TILE


@inlined
@no_type_check
def touches(bounds, s, u, v):
    """Return whether a cell meets the bounds of a shape; without branches, which the processor could not predict.

    Parameters
    ----------
    bounds, s : bounds of all shapes, and the number of one
    u, v : column and row of the cell, as float64

    Returns
    -------
    True where it does
    """
    inside_u = (bounds[s, 0] - 0.5 <= u) & (u <= bounds[s, 1] + 0.5)
    return inside_u & (bounds[s, 2] - 0.5 <= v) & (v <= bounds[s, 3] + 0.5)


@inlined
@no_type_check
def list_active(tiles, row, column, active):
    """Write the shapes whose bounds meet a cell, ascending.

    Parameters
    ----------
    tiles : `Tiles`
    row, column : the cell
    active : written; one entry longer than needed where the last shape does not meet the cell

    Returns
    -------
    number of shapes
    """
    begins, members, bounds, _, across = tiles
    tile = row // TILE * across + column // TILE
    count = np.int64(0)  # a plain 0 is a type of its own to numba, which would compile callees once more
    for i in range(begins[tile], begins[tile + 1]):
        active[count] = members[i]
        count += touches(bounds, members[i], float(column), float(row))
    return count
