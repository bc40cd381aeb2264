"""What the kernels share: the layout of a footprint's numbers, the views of a call, and inlined steps."""

import math
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float32, Float64, Int32
from numba import njit
from torch import Tensor

from recon.ops.rounding import round_down, round_up
from spectra.ops.min_max import larger, smaller

# Where the numbers of a footprint are; of a Gaussian near an end of the rays, the rows are (one past the last, first).
XC, YC, L11, L21, L22, E1, E2, E3, E4, E5, AMPLITUDE, ROW_0, ROW_1 = range(13)
FOOTPRINT_SIZE = 13
NARROWEST = 1 / 12  # variance of a pixel [pixel^2]
NEGLIGIBLE = 18.0  # exponent; exp(-18) is below the resolution of float32
f4 = np.float32


class Footprints(NamedTuple):
    """Footprints of all Gaussians in some views.

    Parameters
    ----------
    numbers : xc, yc, l11, l21, l22, e1 to e5, amplitude, as in `recon.ops.rasterize.cpu`; more of divided Gaussians
    bounds : first row, one past the last, first column, one past the last
    """

    numbers: Float32[Tensor, "view gaussian number"]
    bounds: Int32[Tensor, "view gaussian 4"]


class Views(NamedTuple):
    """Several views for the backward pass.

    Parameters
    ----------
    frames, inverses : as in `recon.ops.arguments.RayFrame`, of each view
    tables : the 13 numbers of each footprint in each view
    """

    frames: Float64[np.ndarray, "view 4 3"]
    inverses: Float64[np.ndarray, "view 3 3"]
    tables: Float32[np.ndarray, "view gaussian 13"]


@njit(inline="always")
@no_type_check
def apply(a, x, out):
    """Multiply a matrix by a vector.

    Parameters
    ----------
    a : matrix, 3 x 3
    x : vector, 3
    out : written, a x
    """
    for i in range(3):
        out[i] = a[i, 0] * x[0] + a[i, 1] * x[1] + a[i, 2] * x[2]


@njit(inline="always")
@no_type_check
def cross(a, b, out):
    """Compute the cross product of two vectors.

    Parameters
    ----------
    a, b : vectors, 3
    out : written, a x b
    """
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@njit(inline="always")
@no_type_check
def dot(a, b):
    """Compute the inner product of two vectors.

    Parameters
    ----------
    a, b : vectors, 3

    Returns
    -------
    a . b
    """
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(inline="always")
@no_type_check
def lattice_mass(xc, yc, c11, c12, c22, box, out):
    """Sum a footprint of unit mass over all pixels, with the gradient of the sum.

    Parameters
    ----------
    xc, yc : projected centre [pixels]
    c11, c12, c22 : covariance of the footprint before the pixel averages it [pixel^2]
    box : variance that the pixel adds [pixel^2]; where it is below that of a whole pixel, the sum is 1
    out : written: sum; its derivative in xc, yc and in the covariance's entries 11, 12 (half of both), 22

    Notes
    -----
    By Poisson summation 1 + 2 sum_k exp(-2 pi^2 k^T C k) cos(2 pi k.x) over half of the nearest lattice neighbours k.
    """
    out[0] = 1.0
    out[1:] = 0.0
    if box < NARROWEST:  # pixels that do not average have no mass to keep
        return
    for n in range(4):
        i, j = (1.0, 0.0) if n == 0 else (n - 2.0, 1.0)
        exponent = 2 * math.pi**2 * (i * i * (c11 + box) + 2 * i * j * c12 + j * j * (c22 + box))
        if exponent > NEGLIGIBLE:
            continue
        decay, phase = 2 * math.exp(-exponent), 2 * math.pi * (i * xc + j * yc)
        wave, slope = decay * math.cos(phase), -2 * math.pi * decay * math.sin(phase)
        out[0] += wave
        out[1] += i * slope
        out[2] += j * slope
        wave *= -2 * math.pi**2
        out[3] += i * i * wave
        out[4] += i * j * wave
        out[5] += j * j * wave


@njit(inline="always")
@no_type_check
def row_span(p, dy, k2, columns):
    """Find the columns of a row in which a footprint is not cut off, N <= k2 E.

    Parameters
    ----------
    p : numbers of the footprint
    dy : place of the row, measured from the projected centre [pixels]
    k2 : square of the cutoff
    columns : of the panel

    Returns
    -------
    first column, and one past the last
    """
    a = p[L11] * p[L11] - k2 * p[E3]
    b = p[L11] * p[L21] * dy - f4(0.5) * k2 * (p[E1] + p[E4] * dy)
    c = (p[L21] * p[L21] + p[L22] * p[L22]) * dy * dy - k2 * (f4(1) + dy * (p[E2] + dy * p[E5]))
    if a <= 0:
        return 0, columns
    inside = b * b - a * c
    if inside < 0:
        return 0, 0
    half = math.sqrt(inside)
    low = smaller(larger(p[XC] - (b + half) / a, f4(0)), f4(columns))
    high = smaller(larger(p[XC] + (half - b) / a, f4(-1)), f4(columns - 1))
    return round_up(low), round_down(high) + 1
