"""Blocks of pixels: sums over blocks, and pixels that lie in blocks."""

import numpy as np
from jaxtyping import Bool, Float


def sum_blocks(images: Float[np.ndarray, "... y x"], factor: int) -> Float[np.ndarray, "... row column"]:
    """Sum `factor` x `factor` pixels to one.

    Parameters
    ----------
    images : images of any unit whose rows and columns are multiples of `factor`
    factor : pixels along each side of a block

    Returns
    -------
    images of the sums
    """
    *front, rows, columns = images.shape
    return images.reshape(*front, rows // factor, factor, columns // factor, factor).sum(axis=(-3, -1))


def touched(
    blocks: Bool[np.ndarray, "block_row block_column"], rows: int, columns: int
) -> Bool[np.ndarray, "row column"]:
    """Find the pixels of a panel that lie in marked blocks of it, wholly or in part.

    Parameters
    ----------
    blocks : marked blocks of the whole panel, no smaller than a pixel
    rows, columns : pixels of the panel

    Returns
    -------
    mask of the pixels
    """
    for axis, size in enumerate((rows, columns)):
        count, pixel = blocks.shape[axis], np.arange(size)
        first, last = pixel * count // size, -(-(pixel + 1) * count // size) - 1
        blocks = blocks.take(first, axis) | blocks.take(last, axis)
    return blocks
