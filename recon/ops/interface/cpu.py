"""Numba kernels: images of divided Gaussians from their footprints, and sums over pixels for the gradients."""

from typing import no_type_check

import numpy as np
from numba import njit

from phantomgen.ops.simd import (
    WIDTH as LANES,
)
from phantomgen.ops.simd import (
    exp_negative,
    load,
    minimum,
    one_more,
    ramp,
    splat,
    square_root,
    store,
    total,
    where_less,
)
from recon.ops.interface.table import (
    AMPLITUDE,
    B0,
    B1,
    B2,
    E1,
    E2,
    E3,
    E4,
    E5,
    L11,
    L21,
    L22,
    OFFSET,
    Q1,
    Q2,
    Q3,
    Q4,
    Q5,
    WIDTH,
    XC,
    YC,
)
from recon.ops.rasterize.footprint_table import row_span
from spectra.ops.min_max import larger, smaller

f4 = np.float32
FAR = 25.0  # square of z beyond which the normal distribution function is taken at 5, 3e-7 from 0 or 1
CLEAR = 5.5  # standard deviations; a row of pixels whose ends are this far on one side of a plane lies there as a whole


@njit(inline="always")
@no_type_check
def normal(z):
    """Compute the normal distribution function and density, error 4e-7.

    Parameters
    ----------
    z : lanes of numbers [standard deviations]

    Returns
    -------
    function and density

    References
    ----------
    Abramowitz & Stegun 1964, equation 7.1.26: erfc(x) = exp(-x^2) times a polynomial in 1 / (1 + 0.3275911 x).
    """
    square = minimum(z * z, f4(FAR))
    bell = exp_negative(square * f4(-0.5))
    t = f4(1) / (square_root(square) * f4(0.3275911 * 0.7071067811865476) + f4(1))
    p = t * f4(0.5 * 1.061405429) + f4(0.5 * -1.453152027)
    p = p * t + f4(0.5 * 1.421413741)
    p = p * t + f4(0.5 * -0.284496736)
    p = p * t + f4(0.5 * 0.254829592)
    tail = p * t * bell
    part = (splat(f4(1)) - tail) + where_less(z, f4(0), tail + tail - splat(f4(1)))
    return part, bell * f4(0.3989422804014327)


@njit(inline="always")
@no_type_check
def side_of(first, last):
    """Tell on which side of a plane a row lies, from z at its ends.

    Parameters
    ----------
    first, last : z at the ends [standard deviations]

    Returns
    -------
    1 above the plane, -1 below it, 0 where the plane crosses the row or comes close
    """
    if first > f4(CLEAR) and last > f4(CLEAR):
        return 1
    return -1 if first < f4(-CLEAR) and last < f4(-CLEAR) else 0


@njit(inline="always", fastmath=True, error_model="numpy")
@no_type_check
def _z(p, x, flat, tilt, level, rise, lean):
    """Compute z at one place of a row, along which it is monotonic but for the divergence of rays in a footprint."""
    e = (x * p[E3] + tilt) * x + flat
    b = x * p[B1] + lean
    above = ((x * p[Q3] + rise) * x + level) - e * p[OFFSET]
    return above / np.sqrt(e * (e * p[WIDTH] + b * b))


@njit(inline="always", fastmath=True, error_model="numpy")
@no_type_check
def _side_of_row(p, low, high, flat, tilt, level, rise, lean):
    """Tell on which side of its plane a row of a footprint lies, from its ends and its middle; see `side_of`."""
    first = _z(p, f4(low) - p[XC], flat, tilt, level, rise, lean)
    middle = _z(p, f4(0.5) * f4(low + high - 1) - p[XC], flat, tilt, level, rise, lean)
    last = _z(p, f4(high - 1) - p[XC], flat, tilt, level, rise, lean)
    side = side_of(first, last)
    return side if side == side_of(middle, middle) else 0


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
@no_type_check
def forward(bases, footprints, sides, lengths, cutoff, columns, part, image):
    """Add footprints to some rows of an image, and multiply by |d|.

    Parameters
    ----------
    bases : a tuple as long as there are bases
    footprints, sides : `Footprints` and `Sides` of all Gaussians
    lengths : length |d| of each ray [mm]
    cutoff : where footprints end [standard deviations]
    columns : of the panel
    part : first row, and one past the last
    image : (basis, row, padded column), in place
    """
    table, spans = footprints
    below, step = sides
    row_first, row_last = part
    _, rows, stride = image.shape
    k2 = f4(cutoff * cutoff)
    for g in range(table.shape[0]):
        p = table[g]
        first = larger(spans[g, 0], row_first)
        row = f4(first - 1)
        for r in range(first, smaller(spans[g, 1], row_last)):
            row = one_more(row)
            dy = row - p[YC]
            low, high = row_span(p, dy, k2, columns)
            shear, across = p[L21] * dy, p[L22] * dy
            flat, tilt = f4(1) + dy * (p[E2] + dy * p[E5]), p[E1] + p[E4] * dy
            level, rise = dy * (p[Q2] + dy * p[Q5]), p[Q1] + p[Q4] * dy
            lean = p[B0] + p[B2] * dy
            side = _side_of_row(p, low, high, flat, tilt, level, rise, lean)
            for base in range(low, high, LANES):
                x = ramp(f4(base) - p[XC])
                e = (x * p[E3] + tilt) * x + flat
                inverse = f4(1) / e
                along = x * p[L11] + shear
                q = (along * along + across * across) * inverse
                value = square_root(inverse) * exp_negative(minimum(q, k2) * f4(-0.5)) * p[AMPLITUDE]
                value = where_less(q, k2, value)
                if side != 0:
                    for m in range(len(bases)):
                        at = (m * rows + r) * stride + base
                        one_side = below[g, m] + step[g, m] if side > 0 else below[g, m]
                        store(image, at, load(image, at) + value * one_side)
                    continue
                b = x * p[B1] + lean
                above = ((x * p[Q3] + rise) * x + level) - e * p[OFFSET]
                z = above * (f4(1) / square_root(e * (e * p[WIDTH] + b * b)))
                upper = normal(z)[0] * value
                for m in range(len(bases)):
                    at = (m * rows + r) * stride + base
                    store(image, at, load(image, at) + value * below[g, m] + upper * step[g, m])
    for m in range(len(bases)):
        for r in range(row_first, row_last):
            for c in range(columns):
                image[m, r, c] *= lengths[r, c]


@njit(forceinline=True, fastmath=True, error_model="numpy")
@no_type_check
def _gather(bases, p, span, sides, cotangent, k2, columns, out):
    """Sums over one Gaussian's pixels: see `backward` for their meaning."""
    below, step = sides
    sums, to_below, to_step = out
    _, rows, stride = cotangent.shape
    zero = splat(f4(0))
    w0, ax, ay, axx, axy, ayy = zero, zero, zero, zero, zero, zero
    e0, ex, ey, exx, exy, eyy = zero, zero, zero, zero, zero, zero
    q0, qx, qy, qxx, qxy, qyy = zero, zero, zero, zero, zero, zero
    b0, bx, by, to_offset, to_width = zero, zero, zero, zero, zero
    first = span[0]
    row = f4(first - 1)
    for r in range(first, span[1]):
        row = one_more(row)
        dy = row - p[YC]
        low, high = row_span(p, dy, k2, columns)
        shear, across = p[L21] * dy, p[L22] * dy
        flat, tilt = f4(1) + dy * (p[E2] + dy * p[E5]), p[E1] + p[E4] * dy
        level, rise = dy * (p[Q2] + dy * p[Q5]), p[Q1] + p[Q4] * dy
        lean = p[B0] + p[B2] * dy
        side = _side_of_row(p, low, high, flat, tilt, level, rise, lean)
        for base in range(low, high, LANES):
            x = ramp(f4(base) - p[XC])
            e = (x * p[E3] + tilt) * x + flat
            inverse = f4(1) / e
            along = x * p[L11] + shear
            q = (along * along + across * across) * inverse
            value = square_root(inverse) * exp_negative(minimum(q, k2) * f4(-0.5)) * p[AMPLITUDE]
            value = where_less(q, k2, value)
            if side != 0:
                to_value = zero
                for m in range(len(bases)):
                    incoming = load(cotangent, (m * rows + r) * stride + base)
                    one_side = below[m] + step[m] if side > 0 else below[m]
                    to_value = to_value + incoming * one_side
                    store(to_below, m * LANES, load(to_below, m * LANES) + incoming * value)
                    if side > 0:
                        store(to_step, m * LANES, load(to_step, m * LANES) + incoming * value)
                to_value = to_value * value
                alpha = to_value * inverse * f4(-0.5)
                to_e = alpha - alpha * q
                w0 = w0 + to_value
                across_x, across_y = alpha * x, alpha * dy
                ax, ay, axx, axy = ax + across_x, ay + across_y, axx + across_x * x, axy + across_x * dy
                ayy = ayy + across_y * dy
                across_x, across_y = to_e * x, to_e * dy
                e0, ex, ey, exx, exy = e0 + to_e, ex + across_x, ey + across_y, exx + across_x * x, exy + across_x * dy
                eyy = eyy + across_y * dy
                continue
            b = x * p[B1] + lean
            above = ((x * p[Q3] + rise) * x + level) - e * p[OFFSET]
            under = f4(1) / (e * p[WIDTH] + b * b)
            scale = square_root(inverse * under)
            z = above * scale
            part, density = normal(z)
            shared = part * value
            to_value, to_part = zero, zero
            for m in range(len(bases)):
                incoming = load(cotangent, (m * rows + r) * stride + base)
                to_value = to_value + incoming * below[m]
                to_part = to_part + incoming * step[m]
                store(to_below, m * LANES, load(to_below, m * LANES) + incoming * value)
                store(to_step, m * LANES, load(to_step, m * LANES) + incoming * shared)
            to_value = (to_value + to_part * part) * value
            to_z = where_less(z * z, f4(FAR), to_part * value * density)
            alpha = to_value * inverse * f4(-0.5)
            to_above = to_z * scale
            half = to_z * z * f4(-0.5)
            to_e = alpha - alpha * q - to_above * p[OFFSET] + half * (inverse + under * p[WIDTH])
            to_b = (half + half) * b * under
            w0 = w0 + to_value
            to_offset = to_offset - to_above * e
            to_width = to_width + half * e * under
            across_x, across_y = alpha * x, alpha * dy
            ax, ay, axx, axy = ax + across_x, ay + across_y, axx + across_x * x, axy + across_x * dy
            ayy = ayy + across_y * dy
            across_x, across_y = to_e * x, to_e * dy
            e0, ex, ey, exx, exy = e0 + to_e, ex + across_x, ey + across_y, exx + across_x * x, exy + across_x * dy
            eyy = eyy + across_y * dy
            across_x, across_y = to_above * x, to_above * dy
            q0, qx, qy, qxx, qxy = q0 + to_above, qx + across_x, qy + across_y, qxx + across_x * x, qxy + across_x * dy
            qyy = qyy + across_y * dy
            b0, bx, by = b0 + to_b, bx + to_b * x, by + to_b * dy
    sums[0], sums[1], sums[2], sums[3], sums[4] = total(w0), total(ax), total(ay), total(axx), total(axy)
    sums[5], sums[6], sums[7], sums[8], sums[9] = total(ayy), total(e0), total(ex), total(ey), total(exx)
    sums[10], sums[11], sums[12], sums[13], sums[14] = total(exy), total(eyy), total(to_offset), total(q0), total(qx)
    sums[15], sums[16], sums[17], sums[18], sums[19] = total(qy), total(qxx), total(qxy), total(qyy), total(b0)
    sums[20], sums[21], sums[22] = total(bx), total(by), total(to_width)


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def backward(bases, footprints, sides, cotangent, cutoff, columns, part, gradients):
    """Sum over the pixels of some Gaussians in one view.

    Parameters
    ----------
    bases : a tuple as long as there are bases
    footprints, sides : `Footprints` and `Sides` of all Gaussians
    cotangent : gradient in the image, multiplied by |d|
    cutoff : where footprints end [standard deviations]
    columns : of the panel
    part : first Gaussian, and one past the last
    gradients : `SideGradients`; sums are written, and gradients in the coefficients added to

    Notes
    -----
    With v the value of a pixel, w = v times the gradient in that value, the sums are w; alpha = -w / (2 E), which
    belongs to the square of the distance, times (x, y, x^2, x y, y^2); the gradient in E, times (1, x, y, x^2, x y,
    y^2); that in OFFSET; that in Q, times the same six; that in B, times (1, x, y); that in WIDTH.
    """
    table, spans = footprints
    below, step = sides
    sums, to_below, to_step = gradients
    k2 = f4(cutoff * cutoff)
    lanes, more = np.empty(len(bases) * LANES, np.float32), np.empty(len(bases) * LANES, np.float32)
    for g in range(part[0], part[1]):
        if spans[g, 1] <= spans[g, 0]:
            continue
        lanes[:] = f4(0)
        more[:] = f4(0)
        out = (sums[g], lanes, more)
        _gather(bases, table[g], spans[g], (below[g], step[g]), cotangent, k2, columns, out)
        for m in range(len(bases)):
            to_below[g, m] += total(load(lanes, m * LANES))
            to_step[g, m] += total(load(more, m * LANES))
