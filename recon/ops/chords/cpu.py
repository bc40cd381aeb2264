"""Numba kernels of the chords: those of the rasterizer, with the square root of a chord in place of the exponential.

In pixels (x, y) from the projected centre, with N, E and amplitude as in `recon.ops.rasterize.cpu` and t = 1 - N / E,
the integral is |d| amplitude 2 / sqrt(2 pi) E^-1/2 root(t) where t > 0. Pixels are sampled at their centres.
"""

import math
from typing import no_type_check

import numpy as np
from numba import njit

from phantomgen.ops.simd import WIDTH, load, minimum, ramp, splat, square_root, store, total, where_less
from recon.ops.rasterize.cpu import SCRATCH, backpropagate, project_centre, write_footprint
from recon.ops.rasterize.footprint_table import (
    AMPLITUDE,
    E3,
    L11,
    ROW_0,
    ROW_1,
    XC,
    YC,
    row_span,
)
from recon.ops.rasterize.pixel_sums import no_pixels, row_terms, with_pixels, write_totals
from spectra.ops.min_max import larger, smaller

f4 = np.float32
UNIT = np.float32(2 / math.sqrt(2 * math.pi))  # chord 2 of a unit ball over the amplitude of a Gaussian's footprint


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def footprints(gaussians, view, rows, first, last, out):
    """Compute the 13 numbers of the footprints of some ellipsoids in one view.

    An ellipsoid that does not lie as a whole between source and panel gets no rows.

    Parameters
    ----------
    gaussians : `recon.ops.arguments.GaussianArrays`, semi-axes in place of standard deviations
    view : `recon.ops.arguments.RayFrame`
    rows : of the panel
    first, last : ellipsoids from `first` to one before `last`
    out : written, (ellipsoid, 13)
    """
    centres, matrices, frame, inverse = gaussians.centres, gaussians.matrices, view.frame, view.inverse
    w = np.empty((SCRATCH, 3))
    for g in range(first, last):
        out[g, ROW_0] = out[g, ROW_1] = f4(0)
        depth, spread = 0.0, 0.0
        for i in range(3):
            depth += inverse[2, i] * (centres[g, i] - frame[0, i])
            along, norm = 0.0, 0.0
            for j in range(3):
                along += inverse[2, j] * matrices[g, i, j]
                norm += matrices[g, i, j] * matrices[g, i, j]
            spread += along * along / (norm * norm)
        half = math.sqrt(spread)
        if not half < depth < 1 - half or not project_centre(centres[g], matrices[g], frame, inverse, 0.0, False, w):
            continue
        low, high = write_footprint(w, 0.0, 1.0, rows, out[g])
        if high > low:
            out[g, ROW_0], out[g, ROW_1] = low, high


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
@no_type_check
def forward(table, coefficients, lengths, smooth, row_first, row_last, image):
    """Add ellipsoids to some rows of an image, then multiply these rows by |d|.

    Parameters
    ----------
    table : numbers of the footprints, (ellipsoid, 13)
    coefficients : (ellipsoid, basis)
    lengths : |d| of each ray [mm], (row, column)
    smooth : t below which a parabola replaces the root
    row_first, row_last : rows from `row_first` to one before `row_last`
    image : added to, then multiplied, (basis, row, column and `WIDTH` columns of padding)
    """
    bases, rows, stride = image.shape
    columns = lengths.shape[1]
    e, corner = f4(smooth), f4(math.sqrt(smooth))
    for g in range(table.shape[0]):
        p = table[g]
        for r in range(larger(int(p[ROW_0]), row_first), smaller(int(p[ROW_1]), row_last)):
            dy = f4(r) - p[YC]
            low, high = row_span(p, dy, f4(1), columns)
            shear, across, flat, tilt = row_terms(p, dy)
            for base in range(low, high, WIDTH):
                x = ramp(f4(base) - p[XC])
                inverse = f4(1) / ((x * p[E3] + tilt) * x + flat)
                along = x * p[L11] + shear
                q = (along * along + across * across) * inverse
                t = f4(1) - q
                under = minimum(t, e)
                part = under * (f4(1) / e)
                root = square_root(t - under + e) + (part * (f4(1.5) - part * f4(0.5)) - f4(1)) * corner
                value = where_less(q, f4(1), square_root(inverse) * root * (p[AMPLITUDE] * UNIT))
                for m in range(bases):
                    at = (m * rows + r) * stride + base
                    store(image, at, load(image, at) + value * coefficients[g, m])
    for m in range(bases):
        for r in range(row_first, row_last):
            for c in range(columns):
                image[m, r, c] *= lengths[r, c]


@njit(forceinline=True, fastmath=True, error_model="numpy")
@no_type_check
def _gather(p, coefficients, cotangent, smooth, columns, sums, to_coefficients):
    """Sum over one ellipsoid's pixels; `recon.ops.rasterize.cpu.backward` defines the sums."""
    bases, rows, stride = cotangent.shape
    e, corner = f4(smooth), f4(math.sqrt(smooth))
    found = no_pixels()
    for r in range(int(p[ROW_0]), int(p[ROW_1])):
        dy = f4(r) - p[YC]
        low, high = row_span(p, dy, f4(1), columns)
        shear, across, flat, tilt = row_terms(p, dy)
        for base in range(low, high, WIDTH):
            x = ramp(f4(base) - p[XC])
            inverse = f4(1) / ((x * p[E3] + tilt) * x + flat)
            along = x * p[L11] + shear
            q = (along * along + across * across) * inverse
            t = f4(1) - q
            under = minimum(t, e)
            part = under * (f4(1) / e)
            long = square_root(t - under + e)
            root = long + (part * (f4(1.5) - part * f4(0.5)) - f4(1)) * corner
            slope = f4(0.5) / long + (f4(1) - part) * (f4(1) / corner)
            height = square_root(inverse) * (p[AMPLITUDE] * UNIT)
            value = where_less(q, f4(1), height * root)
            to_value = splat(f4(0))
            for m in range(bases):
                incoming = load(cotangent, (m * rows + r) * stride + base)
                to_value = to_value + incoming * coefficients[m]
                store(to_coefficients, m * WIDTH, load(to_coefficients, m * WIDTH) + incoming * value)
            alpha = where_less(q, f4(1), to_value * height * slope * inverse) * f4(-1)
            to_value = to_value * value
            beta = to_value * inverse * f4(-0.5) - alpha * q
            found = with_pixels(found, to_value, alpha, beta, x, dy)
    write_totals(found, sums)


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def backward(gaussians, views, cotangents, smooth, first, last, gradients):
    """Add the gradients of some ellipsoids, summed over views in their order.

    Parameters
    ----------
    gaussians : `recon.ops.arguments.GaussianArrays`, semi-axes in place of standard deviations
    views : `recon.ops.rasterize.footprint_table.Views`
    cotangents : gradient in the images, multiplied by |d|, (view, basis, row, column and `WIDTH` columns of padding)
    smooth : t below which a parabola replaces the root
    first, last : ellipsoids from `first` to one before `last`
    gradients : added to, `recon.ops.arguments.GaussianGradients`
    """
    centres, matrices, coefficients = gaussians
    frames, inverses, tables = views
    to_centres, to_matrices, to_coefficients = gradients
    columns = cotangents.shape[3] - WIDTH
    bases = coefficients.shape[1]
    w, sums = np.zeros((SCRATCH, 3)), np.empty(12)
    lanes = np.empty(bases * WIDTH, np.float32)
    for g in range(first, last):
        for v in range(frames.shape[0]):
            p = tables[v, g]
            if p[ROW_1] <= p[ROW_0]:
                continue
            for i in range(bases * WIDTH):
                lanes[i] = f4(0)
            _gather(p, coefficients[g], cotangents[v], smooth, columns, sums, lanes)
            for m in range(bases):
                to_coefficients[g, m] += total(load(lanes, m * WIDTH))
            project_centre(centres[g], matrices[g], frames[v], inverses[v], 0.0, False, w)
            backpropagate(w, sums, False, matrices[g], frames[v], inverses[v], to_centres[g], to_matrices[g])


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def fill(centres, matrices, values, lattice, parts, first, last, out):
    """Add ellipsoids to some slices of a volume.

    Parameters
    ----------
    centres, matrices : of the ellipsoids [mm], [1/mm], (ellipsoid, 3) and (ellipsoid, 3, 3)
    values : attenuation inside [1/mm], (ellipsoid,)
    lattice : `recon.ops.arguments.Lattice`
    parts : sample points per edge of a voxel
    first, last : slices from `first` to one before `last`
    out : added to, (z, y, x)
    """
    origin, spacing = lattice.origin, lattice.spacing
    low, high, x, start = np.empty(3, np.int64), np.empty(3, np.int64), np.empty(3), np.empty(3)
    share = 1 / parts**3
    for g in range(len(centres)):
        a = matrices[g]
        for i in range(3):
            square = 0.0
            for j in range(3):
                norm = a[j, 0] ** 2 + a[j, 1] ** 2 + a[j, 2] ** 2
                square += a[j, i] ** 2 / norm**2
            middle, half = (centres[g, i] - origin[i]) / spacing[i], math.sqrt(square) / spacing[i]
            size = out.shape[2 - i]
            low[i] = max(math.floor(middle - half + 0.5), 0)
            high[i] = min(math.floor(middle + half + 0.5), size - 1)
            start[i] = origin[i] - centres[g, i] + (0.5 / parts - 0.5) * spacing[i]
        for iz in range(max(low[2], first), min(high[2] + 1, last)):
            for iy in range(low[1], high[1] + 1):
                for ix in range(low[0], high[0] + 1):
                    count = 0
                    for s in range(parts**3):
                        x[0] = start[0] + (ix + (s % parts) / parts) * spacing[0]
                        x[1] = start[1] + (iy + (s // parts % parts) / parts) * spacing[1]
                        x[2] = start[2] + (iz + (s // parts**2) / parts) * spacing[2]
                        square = 0.0
                        for j in range(3):
                            along = a[j, 0] * x[0] + a[j, 1] * x[1] + a[j, 2] * x[2]
                            square += along * along
                        count += square < 1
                    out[iz, iy, ix] += values[g] * count * share
