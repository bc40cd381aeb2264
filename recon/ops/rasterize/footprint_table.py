"""What the kernels share: the layout of a footprint's numbers, and inlined steps that several of them take."""

import math
from typing import no_type_check

import numpy as np
from numba import njit

from recon.ops.rounding import round_down, round_up
from spectra.ops.min_max import larger, smaller

# Where the numbers of a footprint are; of a Gaussian near an end of the rays, the rows are (one past the last, first).
XC, YC, L11, L21, L22, E1, E2, E3, E4, E5, AMPLITUDE, ROW_0, ROW_1 = range(13)
FOOTPRINT_SIZE = 13
NARROWEST = 1 / 12  # variance of a pixel [pixel^2]
NEGLIGIBLE = 18.0  # exp(-18) is below the resolution of float32
f4 = np.float32


@njit(inline="always")
@no_type_check
def apply(a, x, out):
    """Write the matrix `a` times `x`."""
    for i in range(3):
        out[i] = a[i, 0] * x[0] + a[i, 1] * x[1] + a[i, 2] * x[2]


@njit(inline="always")
@no_type_check
def cross(a, b, out):
    """Write `a` x `b`."""
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@njit(inline="always")
@no_type_check
def dot(a, b):
    """Inner product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(inline="always")
@no_type_check
def lattice_mass(xc, yc, c11, c12, c22, box, out):
    """Sum of a footprint of unit mass over all pixels, and its gradient; c is its narrow covariance in pixels.

    By Poisson summation 1 + 2 sum_k exp(-2 pi^2 k^T C k) cos(2 pi k.x) over half of the nearest lattice neighbours k.
    `out`: sum, derivative in xc, yc, and in the covariance's entries 11, 12 (half of both), 22.
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
    """First and one past the last column in which N <= k2 E on the row `dy` pixels from the centre."""
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
