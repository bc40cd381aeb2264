"""Gradients of the voxelizer, summed per Gaussian: no atomics, the same bits for any number of threads.

With v the value of a Gaussian in a voxel, d the voxel's offset from the centre and w = v times the gradient in that
value, the gradients depend on the sums of w (1, d, d d^T) over the Gaussian's voxels. Those in covariance and centre
follow from v = amplitude exp(-d^T C^-1 d / 2), where C includes the voxel's own variance.
"""

import math
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float64
from numba import njit

from phantomgen.ops.simd import (
    WIDTH,
    count_from,
    exp_negative,
    load,
    minimum,
    one_more,
    splat,
    store,
    total,
    where_less,
)
from recon.ops.voxelize.cpu import (
    AMPLITUDE,
    HALF_Z,
    U11,
    U12,
    U13,
    U22,
    U23,
    U33,
    VOXEL_X,
    VOXEL_Y,
    VOXEL_Z,
    X,
    Y,
    Z,
    lattice_mass,
    place,
    span,
)
from spectra.ops.min_max import larger

f4 = np.float32


class VoxelizeGradients(NamedTuple):
    """Derivatives of a scalar in Gaussians.

    Parameters
    ----------
    centres, matrices, coefficients : as in `recon.ops.arguments.GaussianGradients`
    log_peaks : derivatives in the logarithm of the peaks
    """

    centres: Float64[np.ndarray, "gaussian 3"]
    matrices: Float64[np.ndarray, "gaussian 3 3"]
    coefficients: Float64[np.ndarray, "gaussian basis"]
    log_peaks: Float64[np.ndarray, " gaussian"]


# Inlined, as all that reorders sums: see `recon.ops.rasterize.cpu`.
@njit(forceinline=True, fastmath=True, error_model="numpy")
@no_type_check
def _gather(bases, p, coefficients, cotangent, k2, columns, sums, to_coefficients):
    """Sum w, w (x, y, z) and w (xx, xy, xz, yy, yz, zz) over one Gaussian's voxels, one row of voxels at a time."""
    _, slices, rows, stride = cotangent.shape
    nx, ny, nz = int(p[VOXEL_X]), int(p[VOXEL_Y]), int(p[VOXEL_Z])
    zero = splat(f4(0))
    w0, wx, wy, wz, wxx, wxy, wxz, wyy, wyz, wzz = zero, zero, zero, zero, zero, zero, zero, zero, zero, zero
    for z in range(*span(p[Z], p[HALF_Z], nz, 0, slices)):
        dz = f4(z - nz) - p[Z]
        high_z = p[U33] * dz
        rest_z = k2 - high_z * high_z
        half = math.sqrt(larger(rest_z, f4(0))) / p[U22]
        middle = p[Y] - p[U23] * dz / p[U22]
        y0, y1 = span(middle, half, ny, 0, rows)
        row = f4(y0 - ny - 1)
        for y in range(y0, y1):
            row = one_more(row)
            dy = row - p[Y]
            slope = p[U22] * dy + p[U23] * dz
            rest = larger(rest_z - slope * slope, f4(0))
            shear = p[U12] * dy + p[U13] * dz
            half = math.sqrt(rest) / p[U11]
            low, high = span(p[X] - shear / p[U11], half, nx, 0, columns)
            r0, rx, rxx = zero, zero, zero
            for base in range(low, high, WIDTH):
                x = count_from(base - nx) - splat(p[X])
                along = x * p[U11] + shear
                q = along * along + (k2 - rest)
                value = where_less(q, k2, exp_negative(minimum(q, k2) * f4(-0.5)) * p[AMPLITUDE])
                to_value = zero
                for m in range(len(bases)):
                    incoming = load(cotangent, ((m * slices + z) * rows + y) * stride + base)
                    to_value = to_value + incoming * coefficients[m]
                    store(to_coefficients, m * WIDTH, load(to_coefficients, m * WIDTH) + incoming * value)
                to_value = to_value * value
                step = to_value * x
                r0, rx, rxx = r0 + to_value, rx + step, rxx + step * x
            w0, wx, wxx = w0 + r0, wx + rx, wxx + rxx
            ry, rz = r0 * dy, r0 * dz
            wy, wz = wy + ry, wz + rz
            wxy, wxz = wxy + rx * dy, wxz + rx * dz
            wyy, wyz, wzz = wyy + ry * dy, wyz + ry * dz, wzz + rz * dz
    sums[0], sums[1], sums[2], sums[3], sums[4] = total(w0), total(wx), total(wy), total(wz), total(wxx)
    sums[5], sums[6], sums[7], sums[8], sums[9] = total(wxy), total(wxz), total(wyy), total(wyz), total(wzz)


@njit(inline="always")
@no_type_check
def _symmetric(upper, first, out):
    """Fill the 3 x 3 matrix `out` from the entries 11, 12, 13, 22, 23, 33 at `first` of `upper`."""
    out[0, 0], out[0, 1], out[0, 2] = upper[first], upper[first + 1], upper[first + 2]
    out[1, 0], out[1, 1], out[1, 2] = upper[first + 1], upper[first + 3], upper[first + 4]
    out[2, 0], out[2, 1], out[2, 2] = upper[first + 2], upper[first + 4], upper[first + 5]


@njit(inline="always")
@no_type_check
def _product(a, b, out):
    """Multiply two 3 x 3 matrices."""
    for i in range(3):
        for j in range(3):
            out[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]


@njit(inline="always")
@no_type_check
def _inverse(c, p):
    """Write the inverse `p` of a symmetric 3 x 3 matrix `c`."""
    p[0, 0], p[1, 1] = c[1, 1] * c[2, 2] - c[1, 2] ** 2, c[0, 0] * c[2, 2] - c[0, 2] ** 2
    p[2, 2], p[0, 1] = c[0, 0] * c[1, 1] - c[0, 1] ** 2, c[0, 2] * c[1, 2] - c[0, 1] * c[2, 2]
    p[0, 2], p[1, 2] = c[0, 1] * c[1, 2] - c[0, 2] * c[1, 1], c[0, 1] * c[0, 2] - c[0, 0] * c[1, 2]
    det = c[0, 0] * p[0, 0] + c[0, 1] * p[0, 1] + c[0, 2] * p[0, 2]
    p[1, 0], p[2, 0], p[2, 1] = p[0, 1], p[0, 2], p[1, 2]
    for i in range(3):
        for j in range(3):
            p[i, j] /= det


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def _backpropagate(sums, centre, a, sampling, t, to_centre, to_matrix):
    """Compute gradients in a Gaussian's centre and whitening matrix from sums over voxels: `place` in reverse.

    `t` is scratch, (8, 3, 3). The factor of the peak that is the product of the standard deviations is left out.
    """
    spacing, box = sampling.spacing, sampling.box
    c, p, s, h, g, v = t[0], t[1], t[2], t[3], t[4], t[5]
    norms, x, voxel, slopes = t[6, 0], t[6, 1], t[6, 2], t[7].reshape(9)
    place(centre, a, sampling, norms, c, x, voxel)
    per_mass = -sums[0] / lattice_mass(x, c, box, slopes)
    _inverse(c, p)
    _symmetric(sums, 4, s)
    _product(p, s, h)
    _product(h, p, g)
    _symmetric(slopes, 3, h)
    for i in range(3):
        pulled = p[i, 0] * sums[1] + p[i, 1] * sums[2] + p[i, 2] * sums[3]
        to_centre[i] = (pulled + per_mass * slopes[i]) / spacing[i]
        for j in range(3):
            g[i, j] = (0.5 * (g[i, j] - sums[0] * p[i, j]) + per_mass * h[i, j]) / (spacing[i] * spacing[j])
            v[i, j] = 0.0
            for k in range(3):
                v[i, j] += a[k, i] * a[k, j] / (norms[k] * norms[k])
    _product(g, v, s)  # covariance V = A^-1 A^-T, so the gradient in A is -2 A^-T G V
    _product(a, s, h)
    for i in range(3):
        for j in range(3):
            to_matrix[i, j] = -2 * h[i, j] / norms[i]


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def backward(bases, gaussians, table, cotangent, sampling, first, last, gradients):
    """Compute the gradients of some Gaussians.

    Parameters
    ----------
    bases : as in `recon.ops.voxelize.cpu.fill`
    gaussians : `recon.ops.arguments.GaussianArrays`
    table : numbers of the Gaussians, (gaussian, 15)
    cotangent : gradient in the volume, zero in the padding, (basis, z, y, x and `WIDTH` voxels of padding)
    sampling : `recon.ops.voxelize.cpu.VoxelSampling`
    first, last : Gaussians from `first` to one before `last`
    gradients : written, `VoxelizeGradients`
    """
    k2, columns = f4(sampling.cutoff * sampling.cutoff), cotangent.shape[3] - WIDTH
    t, sums = np.zeros((8, 3, 3)), np.empty(10)
    lanes = np.empty(len(bases) * WIDTH, np.float32)
    for g in range(first, last):
        for i in range(len(bases) * WIDTH):
            lanes[i] = f4(0)
        _gather(bases, table[g], gaussians.coefficients[g], cotangent, k2, columns, sums, lanes)
        for m in range(len(bases)):
            gradients.coefficients[g, m] = total(load(lanes, m * WIDTH))
        gradients.log_peaks[g] = sums[0]
        _backpropagate(
            sums, gaussians.centres[g], gaussians.matrices[g], sampling, t, gradients.centres[g], gradients.matrices[g]
        )
