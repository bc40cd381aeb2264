"""A panel with fewer columns or larger pixels: images, masks and beam profiles."""

import numpy as np
from jaxtyping import Float, Shaped, UInt32

from spectra.errors import InputError

Image = Shaped[np.ndarray, "... row column"]
Binned = Shaped[np.ndarray, "... large_row large_column"]


def columns_left(columns: int, part: float) -> slice:
    """Return the columns that are left where a part of them is cut off, half of it on each side.

    Parameters
    ----------
    columns : number of columns
    part : what is cut off, 0 to 1; whole columns, the same number on each side

    Returns
    -------
    the columns

    Raises
    ------
    InputError
        When no column is left.
    """
    side = round(part * columns / 2)
    if 2 * side >= columns:
        raise InputError(f"cutting off {part:.4g} of {columns} columns leaves none")
    return slice(side, columns - side)


def check_bin(rows: int, columns: int, factor: int) -> None:
    """Refuse to bin a panel by a number that does not divide it.

    Parameters
    ----------
    rows, columns : of the panel
    factor : pixels along each side

    Raises
    ------
    InputError
        When it does not.
    """
    if rows % factor or columns % factor:
        fitting = [n for n in range(2, min(rows, columns) + 1) if rows % n == columns % n == 0]
        hint = f"{', '.join(map(str, fitting))} would" if fitting else "no other number would; cut off columns first"
        raise InputError(f"{rows} x {columns} pixels cannot be binned by {factor}: {hint}")


def binned_sum(image: Image, factor: int) -> Binned:
    """Sum pixels.

    Parameters
    ----------
    image : values of any type, (..., row, column)
    factor : pixels along each side

    Returns
    -------
    sums, of the type that numpy sums in
    """
    return _blocks(image, factor).sum(axis=(-3, -1)) if factor > 1 else image


def binned_mask(mask: UInt32[np.ndarray, "row column"], factor: int) -> UInt32[np.ndarray, "large_row large_column"]:
    """Combine masks: a pixel has the faults of all pixels that it consists of.

    Parameters
    ----------
    mask : bits of each pixel
    factor : pixels along each side

    Returns
    -------
    bits of the larger pixels
    """
    return np.bitwise_or.reduce(np.bitwise_or.reduce(_blocks(mask, factor), axis=-1), axis=-2)


def binned_mean(
    values: Float[np.ndarray, "... row column"], factor: int
) -> Float[np.ndarray, "... large_row large_column"]:
    """Average pixels.

    Parameters
    ----------
    values : (..., row, column)
    factor : pixels along each side

    Returns
    -------
    means
    """
    return _blocks(values, factor).mean(axis=(-3, -1))


def _blocks(image: Image, factor: int) -> Shaped[np.ndarray, "... large_row y large_column x"]:
    """Pixels (..., large row, y, large column, x) by the larger pixel that they go to."""
    *before, rows, columns = image.shape
    return image.reshape(*before, rows // factor, factor, columns // factor, factor)
