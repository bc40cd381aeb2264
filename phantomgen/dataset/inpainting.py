"""Interpolation of blind pixels from those around them."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int


def inpainted(
    images: Float[np.ndarray, "... row column"], unseen: Bool[np.ndarray, "row column"]
) -> Float[np.ndarray, "... row column"]:
    """Interpolate unseen pixels linearly between the nearest seen ones along a row or a column.

    The axis with the smaller gap is taken. At the border, where one neighbour is missing, the other gives the value.
    Filtered back-projection needs every pixel; a fit does not, and leaves these out.

    Parameters
    ----------
    images : images of any unit
    unseen : pixels without a value

    Returns
    -------
    images with all values; `images` itself where no pixel or every pixel is unseen
    """
    if not unseen.any() or unseen.all():
        return images
    along = [_between(~unseen), _Neighbours(*(x.T for x in _between(~unseen.T)))]
    row, column = np.nonzero(unseen)
    whole, best = images.copy(), np.full(len(row), np.inf)
    for (before, after, gap), axis in zip(along, (1, 0), strict=True):
        better = gap[row, column] < best
        r, c = row[better], column[better]
        best[better] = gap[r, c]
        a, b = before[r, c], after[r, c]
        part = (((r, c)[axis] - a) / np.maximum(b - a, 1)).astype(images.dtype)
        ends = [images[..., r, x] if axis == 1 else images[..., x, c] for x in (a, b)]
        whole[..., r, c] = (1 - part) * ends[0] + part * ends[1]
    left = np.zeros_like(unseen)
    left[row[np.isinf(best)], column[np.isinf(best)]] = True
    return inpainted(whole, left)


class _Neighbours(NamedTuple):
    """Nearest seen places before and after every pixel along one axis, and the gap between them; inf without any."""

    before: Int[np.ndarray, "row column"]
    after: Int[np.ndarray, "row column"]
    gap: Float[np.ndarray, "row column"]


def _between(seen: Bool[np.ndarray, "row column"]) -> _Neighbours:
    """Nearest seen columns in the row of every pixel."""
    count = seen.shape[1]
    column = np.broadcast_to(np.arange(count), seen.shape)
    before = np.maximum.accumulate(np.where(seen, column, -1), axis=1)
    after = np.minimum.accumulate(np.where(seen, column, count)[:, ::-1], axis=1)[:, ::-1]
    first, last = before < 0, after >= count
    gap = np.where(first & last, np.inf, np.where(first | last, 2.0 * count, 0.0) + after - before)
    before, after = np.where(first, after, before), np.where(last, before, after)
    return _Neighbours(before, after, gap)
