"""Which shapes may be met in which part of a panel.

A panel is cut into square tiles, and each tile lists the shapes whose bounds meet one of its cells. A ray then tests
the shapes of its tile in place of all of them.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int64

# Cells along each edge of a tile: small tiles cost memory where shapes are large, large ones time where they are small.
# No change of results.
TILE = 8


class Tiles(NamedTuple):
    """Lists of shapes per tile.

    Parameters
    ----------
    starts : tile ``row // TILE * across + column // TILE`` lists ``members[starts[tile] : starts[tile + 1]]``
    members : indices of shapes, ascending in each tile
    bounds : lowest u, highest u, lowest v, highest v of each shape
    firsts : shape s has the silhouettes ``firsts[s]`` to ``firsts[s + 1]``
    across : tiles side by side
    """

    starts: Int64[np.ndarray, " boundary"]
    members: Int64[np.ndarray, " entry"]
    bounds: Float[np.ndarray, "shape 4"]
    firsts: Int64[np.ndarray, " boundary"]
    across: int

    @classmethod
    def of(
        cls, bounds: Float[np.ndarray, "shape 4"], shapes: Int64[np.ndarray, " form"], rows: int, columns: int
    ) -> "Tiles":
        """Create the tiles of a panel.

        Parameters
        ----------
        bounds : of each shape
        shapes : shape that each silhouette belongs to
        rows, columns : size of the panel

        Returns
        -------
        the tiles
        """
        down, across = -(-rows // TILE), -(-columns // TILE)
        left, right = _reached(bounds[:, 0], bounds[:, 1], columns)
        top, bottom = _reached(bounds[:, 2], bounds[:, 3], rows)
        width = right - left
        count = width * (bottom - top)
        shape = np.repeat(np.arange(len(bounds)), count)
        place = np.arange(len(shape)) - np.repeat(np.cumsum(count) - count, count)
        line, step = np.divmod(place, np.maximum(width, 1)[shape])
        tile = (top[shape] + line) * across + left[shape] + step
        starts = np.concatenate([[0], np.cumsum(np.bincount(tile, minlength=down * across))])
        firsts = np.concatenate([[0], np.cumsum(np.bincount(shapes, minlength=len(bounds)))])
        small = tile.astype(np.uint16) if down * across < 2**16 else tile  # which numpy sorts six times faster
        return cls(starts, shape[np.argsort(small, kind="stable")], bounds, firsts, across)


def _reached(
    low: Float[np.ndarray, " shape"], high: Float[np.ndarray, " shape"], cells: int
) -> tuple[Int64[np.ndarray, " shape"], Int64[np.ndarray, " shape"]]:
    """Half-open range of tiles that bounds along one direction meet; cell i reaches from i - 1/2 to i + 1/2."""
    first = np.clip(np.floor(low - 0.5), 0, cells).astype(np.int64)
    last = np.clip(np.ceil(high + 0.5), -1, cells - 1).astype(np.int64)
    begin, end = first // TILE, last // TILE + 1
    return begin, np.where(first <= last, end, begin)
