"""Numba kernels of the rasterizer.

Three passes. `footprints` reduces a Gaussian seen in a view to 13 numbers; `forward` adds footprints to a band of image
rows (each pixel sums its Gaussians in their order, so the result does not depend on bands or threads); `backward` sums
over the pixels of each Gaussian and computes from the sums, by the chain rule, the gradients of centre, whitening
matrix and coefficients.

In pixels (x, y) from the projected centre the integral is
    |d| amplitude E^-1/2 exp(-N / (2 E)),  N = (l11 x + l21 y)^2 + (l22 y)^2,
    E = 1 + e1 x + e2 y + e3 x^2 + e4 x y + e5 y^2
where N / E <= cutoff^2 bounds the footprint. N is kept as its Cholesky form, which does not cancel in float32.
"""

import math
from typing import no_type_check

import numpy as np
from numba import njit

from phantomgen.ops.simd import (
    WIDTH,
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
from recon.ops.arguments import RayFrame
from recon.ops.rasterize import near_field as near
from recon.ops.rasterize.footprint_table import (
    AMPLITUDE,
    E1,
    E2,
    E3,
    E4,
    E5,
    L11,
    L21,
    L22,
    ROW_0,
    ROW_1,
    XC,
    YC,
    apply,
    cross,
    dot,
    lattice_mass,
    row_span,
)
from recon.ops.rasterize.pixel_sums import no_pixels, row_terms, with_pixels, write_totals
from spectra.ops.min_max import larger, smaller

SCRATCH = 21  # rows of the scratch array of one Gaussian in one view; the last 6 belong to `backpropagate`
HIDDEN, NEAR = near.HIDDEN, near.NEAR
NEAR_SOURCE = 0.5  # part of the way to the panel; up to there all pixels are visited, as a shadow may be that large
f4 = np.float32


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def whitening(log_scales, quaternions, first, last, matrices):
    """Compute the whitening matrices A = S^-1 R^T of some Gaussians.

    Parameters
    ----------
    log_scales : logarithm of the standard deviations [log mm], (gaussian, 3)
    quaternions : orientations (w, x, y, z), not normalised, (gaussian, 4)
    first, last : Gaussians from `first` to one before `last`
    matrices : written [1/mm], (gaussian, 3, 3)
    """
    for g in range(first, last):
        w, x, y, z = quaternions[g, 0], quaternions[g, 1], quaternions[g, 2], quaternions[g, 3]
        n = 2.0 / (w * w + x * x + y * y + z * z)
        for i in range(3):
            s = math.exp(-log_scales[g, i])
            if i == 0:
                a, b, c = 1 - n * (y * y + z * z), n * (x * y + w * z), n * (x * z - w * y)
            elif i == 1:
                a, b, c = n * (x * y - w * z), 1 - n * (x * x + z * z), n * (y * z + w * x)
            else:
                a, b, c = n * (x * z + w * y), n * (y * z - w * x), 1 - n * (x * x + y * y)
            matrices[g, i, 0], matrices[g, i, 1], matrices[g, i, 2] = s * a, s * b, s * c


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def whitening_backward(log_scales, quaternions, matrices, cotangents, first, last, to_log_scales, to_quaternions):
    """Compute gradients in logarithmic scales and quaternions from those in the whitening matrices.

    Parameters
    ----------
    log_scales, quaternions, matrices : as in `whitening`
    cotangents : gradients in the matrices, (gaussian, 3, 3)
    first, last : Gaussians from `first` to one before `last`
    to_log_scales, to_quaternions : written, (gaussian, 3) and (gaussian, 4); quaternions are those before normalisation
    """
    r = np.empty((3, 3))
    for g in range(first, last):
        for i in range(3):
            s = math.exp(-log_scales[g, i])
            change = 0.0
            for j in range(3):
                change -= matrices[g, i, j] * cotangents[g, i, j]
                r[j, i] = s * cotangents[g, i, j]
            to_log_scales[g, i] = change
        w, x, y, z = quaternions[g, 0], quaternions[g, 1], quaternions[g, 2], quaternions[g, 3]
        length = math.sqrt(w * w + x * x + y * y + z * z)
        w, x, y, z = w / length, x / length, y / length, z / length
        gw = 2 * (x * (r[2, 1] - r[1, 2]) + y * (r[0, 2] - r[2, 0]) + z * (r[1, 0] - r[0, 1]))
        gx = 2 * (y * (r[0, 1] + r[1, 0]) + z * (r[0, 2] + r[2, 0]) + w * (r[2, 1] - r[1, 2]))
        gy = 2 * (x * (r[0, 1] + r[1, 0]) + z * (r[1, 2] + r[2, 1]) + w * (r[0, 2] - r[2, 0]))
        gz = 2 * (x * (r[0, 2] + r[2, 0]) + y * (r[1, 2] + r[2, 1]) + w * (r[1, 0] - r[0, 1]))
        gx -= 4 * x * (r[1, 1] + r[2, 2])
        gy -= 4 * y * (r[0, 0] + r[2, 2])
        gz -= 4 * z * (r[0, 0] + r[1, 1])
        radial = gw * w + gx * x + gy * y + gz * z
        to_quaternions[g, 0] = (gw - radial * w) / length
        to_quaternions[g, 1] = (gx - radial * x) / length
        to_quaternions[g, 2] = (gy - radial * y) / length
        to_quaternions[g, 3] = (gz - radial * z) / length


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def project_centre(centre, matrix, frame, inverse, box, affine, w):
    """Compute what a footprint is made of, for one Gaussian in one view.

    Parameters
    ----------
    centre, matrix : of the Gaussian [mm], [1/mm]
    frame, inverse : as in `recon.ops.arguments.RayFrame`
    box : variance that the pixel adds [pixel^2]
    affine : whether the projection is local-affine
    w : written, (21, 3): 0 offset from the source, 1 u, 2 vx, 3 vy, 4 u x vx, 5 u x vy, 6 v at the centre,
        7 (xc, yc, depth), 8 covariance before the pixel averages, 9 inverse of the covariance after that, 10 (D0, mass
        kept, |d| of a local-affine centre), 11 (e1, e2, e3), 12 (e4, e5, 0), 13 and 14 sum over pixels and its gradient

    Returns
    -------
    False where the centre lies behind the source, or the footprint is not finite
    """
    for i in range(3):
        w[0, i] = centre[i] - frame[0, i]
    apply(inverse, w[0], w[7])
    depth = w[7, 2]
    if not depth > 0:
        return False
    w[7, 0] /= depth
    w[7, 1] /= depth
    apply(matrix, w[0], w[1])
    apply(matrix, frame[2], w[2])
    apply(matrix, frame[3], w[3])
    cross(w[1], w[2], w[4])
    cross(w[1], w[3], w[5])
    for i in range(3):
        w[6, i] = w[1, i] / depth
    d0 = dot(w[6], w[6])
    volume = dot(w[4], w[3])  # det[u, vx, vy]; det of the precision without cancellation
    det = depth * depth * volume * volume / d0
    c11, c12, c22 = dot(w[5], w[5]) / d0 / det, -dot(w[4], w[5]) / d0 / det, dot(w[4], w[4]) / d0 / det
    det_wide = 1 / det + box * (c11 + c22) + box * box
    w[8, 0], w[8, 1], w[8, 2] = c11, c12, c22
    w[9, 0], w[9, 1], w[9, 2] = (c22 + box) / det_wide, -c12 / det_wide, (c11 + box) / det_wide
    lattice_mass(w[7, 0], w[7, 1], c11, c12, c22, box, w[13:15].reshape(6))
    w[10, 0], w[10, 1] = d0, 1 / (math.sqrt(det * det_wide) * w[13, 0])
    w[11, 0], w[11, 1], w[11, 2] = 2 * dot(w[6], w[2]) / d0, 2 * dot(w[6], w[3]) / d0, dot(w[2], w[2]) / d0
    w[12, 0], w[12, 1] = 2 * dot(w[2], w[3]) / d0, dot(w[3], w[3]) / d0
    w[10, 2] = 1.0
    if affine:
        w[11] = 0.0
        w[12] = 0.0
        w[10, 2] = math.sqrt(dot(w[0], w[0])) / depth
    return math.isfinite(det_wide) and det > 0


@njit(inline="always")
@no_type_check
def write_footprint(w, box, k2, rows, out):
    """Write the numbers of a footprint except its rows; nothing where it has no rows.

    Parameters
    ----------
    w : vectors of `project_centre`
    box : variance that the pixel adds [pixel^2]
    k2 : square of the cutoff
    rows : of the panel
    out : written, (13,)

    Returns
    -------
    first row, and one past the last
    """
    p11, p12, p22 = w[9, 0], w[9, 1], w[9, 2]
    e1, e2, e3, e4, e5 = w[11, 0], w[11, 1], w[11, 2], w[12, 0], w[12, 1]
    q11, q12, q22 = p11 - k2 * e3, p12 - k2 * e4 / 2, p22 - k2 * e5
    det = q11 * q22 - q12 * q12
    low, high = 0.0, float(rows)
    if q11 > 0 and det > 0:  # an ellipse; otherwise the bound is open and all rows are visited
        middle = w[7, 1] + k2 / 2 * (q11 * e2 - q12 * e1) / det
        square = k2 + k2 * k2 / 4 * (q22 * e1 * e1 - 2 * q12 * e1 * e2 + q11 * e2 * e2) / det
        half = math.sqrt(square * q11 / det)
        low, high = max(low, math.ceil(middle - half)), min(high, math.floor(middle + half) + 1)
    if high > low:
        out[XC], out[YC] = w[7, 0], w[7, 1]
        out[L11], out[L21] = math.sqrt(p11), p12 / math.sqrt(p11)
        out[L22] = 1 / math.sqrt(w[8, 2] + box)
        out[E1], out[E2], out[E3], out[E4], out[E5] = e1, e2, e3, e4, e5
        out[AMPLITUDE] = w[10, 1] * math.sqrt(2 * math.pi / w[10, 0]) * w[10, 2]
    return low, high


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def footprints(gaussians, view, sampling, rows, first, last, out):
    """Compute the 13 numbers of the footprints of some Gaussians in one view.

    Those of a Gaussian near an end of the rays only bound it; `recon.ops.rasterize.near_field` computes its pixels.

    Parameters
    ----------
    gaussians : `recon.ops.arguments.GaussianArrays`
    view : `recon.ops.arguments.RayFrame`
    sampling : `recon.ops.rasterize.projector.PixelSampling`
    rows : of the panel
    first, last : Gaussians from `first` to one before `last`
    out : written, (gaussian, 13)
    """
    centres, matrices, frame, inverse = gaussians.centres, gaussians.matrices, view.frame, view.inverse
    box, affine = sampling.box, sampling.affine
    w = np.empty((SCRATCH, 3))
    k2 = sampling.cutoff * sampling.cutoff
    for g in range(first, last):
        out[g, ROW_0] = out[g, ROW_1] = f4(0)
        kind = near.BETWEEN
        if not affine:
            kind = near.classify(centres[g], matrices[g], view, k2)
            if kind == HIDDEN:
                continue
        seen = project_centre(centres[g], matrices[g], frame, inverse, box, affine, w)
        if kind == NEAR and (not seen or w[7, 2] < NEAR_SOURCE):  # all pixels
            for i in range(XC, AMPLITUDE):
                out[g, i] = f4(0)
            out[g, E3], out[g, ROW_0], out[g, ROW_1] = f4(1), f4(rows), f4(0)
            continue
        if not seen or (affine and w[7, 2] >= 1):
            continue
        low, high = write_footprint(w, box, k2, rows, out[g])
        if high > low:
            out[g, ROW_0], out[g, ROW_1] = (high, low) if kind == NEAR else (low, high)


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
@no_type_check
def forward(bases, table, coefficients, lengths, cutoff, row_first, row_last, image):
    """Add footprints to some rows of an image, then multiply these rows by |d|.

    Parameters
    ----------
    bases : tuple with one entry per basis; its length is known when numba compiles, which unrolls the loops over bases
    table : numbers of the footprints, (gaussian, 13)
    coefficients : (gaussian, basis)
    lengths : |d| of each ray [mm], (row, column)
    cutoff : where a footprint ends [standard deviations]
    row_first, row_last : rows from `row_first` to one before `row_last`
    image : added to, then multiplied, (basis, row, column and `WIDTH` columns of padding)
    """
    _, rows, stride = image.shape
    columns = lengths.shape[1]
    k2 = f4(cutoff * cutoff)
    for g in range(table.shape[0]):
        p = table[g]
        first = larger(int(p[ROW_0]), row_first)
        row = f4(first - 1)
        for r in range(first, smaller(int(p[ROW_1]), row_last)):
            row = one_more(row)
            dy = row - p[YC]
            low, high = row_span(p, dy, k2, columns)
            shear, across, flat, tilt = row_terms(p, dy)
            for base in range(low, high, WIDTH):
                x = ramp(f4(base) - p[XC])
                inverse = f4(1) / ((x * p[E3] + tilt) * x + flat)
                along = x * p[L11] + shear
                q = (along * along + across * across) * inverse
                value = square_root(inverse) * exp_negative(minimum(q, k2) * f4(-0.5)) * p[AMPLITUDE]
                value = where_less(q, k2, value)
                for m in range(len(bases)):
                    at = (m * rows + r) * stride + base
                    store(image, at, load(image, at) + value * coefficients[g, m])
    for m in range(len(bases)):
        for r in range(row_first, row_last):
            for c in range(columns):
                image[m, r, c] *= lengths[r, c]


# Inlined, as all that reorders sums: the process that compiles a kernel may call another copy of a function in it than
# processes that load the kernel from numba's cache, and copies may round differently.
@njit(forceinline=True, fastmath=True, error_model="numpy")
@no_type_check
def _gather(bases, p, coefficients, cotangent, k2, columns, sums, to_coefficients):
    """Sum over one Gaussian's pixels; `backward` defines the sums."""
    _, rows, stride = cotangent.shape
    found = no_pixels()
    first = int(p[ROW_0])
    row = f4(first - 1)
    for r in range(first, int(p[ROW_1])):
        row = one_more(row)
        dy = row - p[YC]
        low, high = row_span(p, dy, k2, columns)
        shear, across, flat, tilt = row_terms(p, dy)
        for base in range(low, high, WIDTH):
            x = ramp(f4(base) - p[XC])
            inverse = f4(1) / ((x * p[E3] + tilt) * x + flat)
            along = x * p[L11] + shear
            q = (along * along + across * across) * inverse
            value = square_root(inverse) * exp_negative(minimum(q, k2) * f4(-0.5)) * p[AMPLITUDE]
            value = where_less(q, k2, value)
            to_value = splat(f4(0))
            for m in range(len(bases)):
                incoming = load(cotangent, (m * rows + r) * stride + base)
                to_value = to_value + incoming * coefficients[m]
                store(to_coefficients, m * WIDTH, load(to_coefficients, m * WIDTH) + incoming * value)
            to_value = to_value * value
            alpha = to_value * inverse * f4(-0.5)
            beta = alpha - alpha * q
            found = with_pixels(found, to_value, alpha, beta, x, dy)
    write_totals(found, sums)


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def backpropagate(w, s, affine, matrix, frame, inverse, to_centre, to_matrix):
    """Compute gradients in centre and whitening matrix from sums over pixels: `project_centre` in reverse.

    Parameters
    ----------
    w : vectors of `project_centre`
    s : sums over the pixels of the footprint, see `backward`
    affine : whether the projection is local-affine
    matrix : whitening matrix [1/mm]
    frame, inverse : as in `recon.ops.arguments.RayFrame`
    to_centre, to_matrix : added to, (3,) and (3, 3)
    """
    t = w[15:]
    xc, yc, depth = w[7, 0], w[7, 1], w[7, 2]
    c11, c12, c22 = w[8, 0], w[8, 1], w[8, 2]
    p11, p12, p22 = w[9, 0], w[9, 1], w[9, 2]
    d0 = w[10, 0]
    e1, e2, e3, e4, e5 = w[11, 0], w[11, 1], w[11, 2], w[12, 0], w[12, 1]
    # wide precision P: -P G P, and the logarithm of the mass kept: (narrow precision - P) / 2
    g11 = p11 * p11 * s[3] + 2 * p11 * p12 * s[4] + p12 * p12 * s[5]
    g12 = p11 * p12 * s[3] + (p11 * p22 + p12 * p12) * s[4] + p12 * p22 * s[5]
    g22 = p12 * p12 * s[3] + 2 * p12 * p22 * s[4] + p22 * p22 * s[5]
    det = c11 * c22 - c12 * c12
    per_mass = -s[0] / w[13, 0]
    h11 = -g11 + s[0] / 2 * (c22 / det - p11) + per_mass * w[14, 0]
    h12 = -g12 + s[0] / 2 * (-c12 / det - p12) + per_mass * w[14, 1]
    h22 = -g22 + s[0] / 2 * (c11 / det - p22) + per_mass * w[14, 2]
    # narrow covariance C back to its precision: -C H C, then divided by D0 to the products of u x vx and u x vy
    n11 = -(c11 * c11 * h11 + 2 * c11 * c12 * h12 + c12 * c12 * h22) / d0
    n12 = -(c11 * c12 * h11 + (c11 * c22 + c12 * c12) * h12 + c12 * c22 * h22) / d0
    n22 = -(c12 * c12 * h11 + 2 * c12 * c22 * h12 + c22 * c22 * h22) / d0
    to_d0 = -(n11 * c22 - 2 * n12 * c12 + n22 * c11) / det
    to_d0 -= (e1 * s[7] + e2 * s[8] + e3 * s[9] + e4 * s[10] + e5 * s[11] + s[0] / 2) / d0
    to_xc = -2 * (p11 * s[1] + p12 * s[2]) - (e1 * s[6] + 2 * e3 * s[7] + e4 * s[8]) + per_mass * w[13, 1]
    to_yc = -2 * (p12 * s[1] + p22 * s[2]) - (e2 * s[6] + e4 * s[7] + 2 * e5 * s[8]) + per_mass * w[13, 2]
    if affine:  # the length of the ray through the centre
        square = dot(w[0], w[0]) / (depth * depth)
        for i in range(3):
            along = (frame[1, i] + xc * frame[2, i] + yc * frame[3, i]) * s[0] / square
            to_xc += along * frame[2, i]
            to_yc += along * frame[3, i]
    u, vx, vy, a, b, v = w[1], w[2], w[3], w[4], w[5], w[6]
    for i in range(3):
        t[0, i] = 2 * (n11 * a[i] + n12 * b[i])
        t[1, i] = 2 * (n12 * a[i] + n22 * b[i])
    cross(vx, t[0], t[2])
    cross(vy, t[1], t[3])
    cross(t[0], u, t[4])
    cross(t[1], u, t[5])
    to_depth = -(xc * to_xc + yc * to_yc) / depth
    for i in range(3):
        to_v = 2 * (to_d0 * v[i] + (s[7] * vx[i] + s[8] * vy[i]) / d0)
        t[4, i] += 2 * (s[7] * v[i] + s[9] * vx[i] + s[10] * vy[i]) / d0
        t[5, i] += 2 * (s[8] * v[i] + s[10] * vx[i] + s[11] * vy[i]) / d0
        t[2, i] += t[3, i] + to_v / depth
        to_depth -= to_v * v[i] / depth
    for j in range(3):
        to_centre[j] += (to_xc * inverse[0, j] + to_yc * inverse[1, j]) / depth + to_depth * inverse[2, j]
        for i in range(3):
            to_centre[j] += matrix[i, j] * t[2, i]
            to_matrix[i, j] += t[2, i] * w[0, j] + t[4, i] * frame[2, j] + t[5, i] * frame[3, j]


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def backward(bases, gaussians, views, cotangents, sampling, first, last, gradients):
    """Add the gradients of some Gaussians, summed over views in their order.

    Parameters
    ----------
    bases : as in `forward`
    gaussians : `recon.ops.arguments.GaussianArrays`
    views : `recon.ops.rasterize.footprint_table.Views`
    cotangents : gradient in the images, multiplied by |d|, (view, basis, row, column and `WIDTH` columns of padding)
    sampling : `recon.ops.rasterize.projector.PixelSampling`
    first, last : Gaussians from `first` to one before `last`
    gradients : added to, `recon.ops.arguments.GaussianGradients`

    Notes
    -----
    With v the value of a pixel, w = v times the gradient in that value, alpha = -w / (2 E) belongs to N, and
    beta = alpha (1 - N / E) to E; the sums over pixels are w, alpha (x, y, x^2, x y, y^2) and
    beta (1, x, y, x^2, x y, y^2).
    """
    # Named here, as numba counts a reference each time an array is taken out of a tuple.
    centres, matrices, coefficients = gaussians
    frames, inverses, tables = views
    to_centres, to_matrices, to_coefficients = gradients
    box, affine, k2 = sampling.box, sampling.affine, f4(sampling.cutoff * sampling.cutoff)
    columns = cotangents.shape[3] - WIDTH
    w, sums = np.zeros((SCRATCH, 3)), np.empty(12)
    lanes = np.empty(len(bases) * WIDTH, np.float32)
    for g in range(first, last):
        for v in range(frames.shape[0]):
            p = tables[v, g]
            if p[ROW_1] < p[ROW_0]:
                view = RayFrame(frames[v], inverses[v])
                near.backward(gaussians, g, view, p, cotangents[v], sampling, gradients)
            if p[ROW_1] <= p[ROW_0]:
                continue
            lanes[:] = f4(0)
            _gather(bases, p, coefficients[g], cotangents[v], k2, columns, sums, lanes)
            for m in range(len(bases)):
                to_coefficients[g, m] += total(load(lanes, m * WIDTH))
            project_centre(centres[g], matrices[g], frames[v], inverses[v], box, affine, w)
            if affine:
                sums[6:] = 0.0
            backpropagate(w, sums, affine, matrices[g], frames[v], inverses[v], to_centres[g], to_matrices[g])
