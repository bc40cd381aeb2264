"""Steps that loops over the pixels of a footprint share: the terms of a row, and sums over pixels for the gradients."""

from typing import Any, NamedTuple, no_type_check

import numpy as np
from numba import njit

from phantomgen.ops.simd import splat, total
from recon.ops.rasterize.footprint_table import E1, E2, E4, E5, L21, L22

f4 = np.float32


class PixelSums(NamedTuple):
    """Sums over the pixels of one footprint, each a vector of partial sums; see `recon.ops.rasterize.cpu.backward`.

    Parameters
    ----------
    w : sum of w
    ax, ay, axx, axy, ayy : sums of alpha times x, y, x^2, x y, y^2
    b, bx, by, bxx, bxy, byy : sums of beta times 1, x, y, x^2, x y, y^2
    """

    w: Any
    ax: Any
    ay: Any
    axx: Any
    axy: Any
    ayy: Any
    b: Any
    bx: Any
    by: Any
    bxx: Any
    bxy: Any
    byy: Any


@njit(inline="always")
@no_type_check
def row_terms(p, dy):
    """Compute the terms of N and E that are the same in all pixels of a row.

    Parameters
    ----------
    p : numbers of the footprint, (13,)
    dy : place of the row, measured from the projected centre [pixels]

    Returns
    -------
    l21 y, l22 y; 1 + e2 y + e5 y^2, e1 + e4 y
    """
    return p[L21] * dy, p[L22] * dy, f4(1) + dy * (p[E2] + dy * p[E5]), p[E1] + p[E4] * dy


@njit(inline="always")
@no_type_check
def no_pixels():
    """Start sums over pixels.

    Returns
    -------
    `PixelSums`, all 0
    """
    zero = splat(f4(0))
    return PixelSums(zero, zero, zero, zero, zero, zero, zero, zero, zero, zero, zero, zero)


@njit(inline="always")
@no_type_check
def with_pixels(s, w, alpha, beta, x, dy):
    """Add a vector of pixels to the sums.

    Parameters
    ----------
    s : `PixelSums`
    w, alpha, beta : of the pixels
    x, dy : places of the pixels, measured from the projected centre [pixels]

    Returns
    -------
    `PixelSums`
    """
    ax, ay, bx, by = alpha * x, alpha * dy, beta * x, beta * dy
    return PixelSums(
        s.w + w, s.ax + ax, s.ay + ay, s.axx + ax * x, s.axy + ax * dy, s.ayy + ay * dy,
        s.b + beta, s.bx + bx, s.by + by, s.bxx + bx * x, s.bxy + bx * dy, s.byy + by * dy,
    )  # fmt: skip


@njit(inline="always")
@no_type_check
def write_totals(s, out):
    """Write the sums over all pixels.

    Parameters
    ----------
    s : `PixelSums`
    out : written, in the order of the fields, (12,)
    """
    out[0], out[1], out[2], out[3] = total(s.w), total(s.ax), total(s.ay), total(s.axx)
    out[4], out[5], out[6], out[7] = total(s.axy), total(s.ayy), total(s.b), total(s.bx)
    out[8], out[9], out[10], out[11] = total(s.by), total(s.bxx), total(s.bxy), total(s.byy)
