"""Numba kernels of the voxelizer.

`shapes` reduces a Gaussian to 12 numbers in voxel units; `fill` adds all Gaussians to a slab of slices, each voxel in
the order of the Gaussians. In voxels (x, y, z) from the centre the exponent is half of
(u11 x + u12 y + u13 z)^2 + (u22 y + u23 z)^2 + (u33 z)^2, cut off where it exceeds cutoff^2.
"""

import math
from typing import no_type_check

import numpy as np
from numba import njit

from recon.ops.simd import WIDTH, exp_negative, load, minimum, ramp, store, where_less

X, Y, Z, U11, U12, U13, U22, U23, U33, AMPLITUDE, HALF_Z, HALF_Y = range(12)
SHAPE_SIZE = 12
f4 = np.float32


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def shapes(centres, matrices, origin, spacing, box, cutoff, first, last, out):
    """Write the 12 numbers of Gaussians `first` to `last` into `out`.

    `matrices` are the whitening matrices A = S^-1 R^T, so the covariance is (A^T A)^-1; `origin` and `spacing` are
    (x, y, z) [mm]; `box` is the variance of a voxel in voxels^2.
    """
    c = np.empty((3, 3))
    for g in range(first, last):
        a = matrices[g]
        norms = np.empty(3)
        for i in range(3):
            norms[i] = a[i, 0] ** 2 + a[i, 1] ** 2 + a[i, 2] ** 2
        for i in range(3):
            for j in range(3):
                c[i, j] = 0.0
                for k in range(3):  # R S^2 R^T with R S = A^T / |row|^2
                    c[i, j] += a[k, i] * a[k, j] / (norms[k] * norms[k])
                c[i, j] /= spacing[i] * spacing[j]
        narrow = 1 / (norms[0] * norms[1] * norms[2] * (spacing[0] * spacing[1] * spacing[2]) ** 2)
        for i in range(3):
            c[i, i] += box
        # inverse of the Cholesky factor of C, from the last axis to the first: C = L L^T with L upper triangular
        l33 = math.sqrt(c[2, 2])
        l23, l13 = c[1, 2] / l33, c[0, 2] / l33
        l22 = math.sqrt(c[1, 1] - l23 * l23)
        l12 = (c[0, 1] - l13 * l23) / l22
        l11 = math.sqrt(c[0, 0] - l12 * l12 - l13 * l13)
        out[g, X] = (centres[g, 0] - origin[0]) / spacing[0]
        out[g, Y] = (centres[g, 1] - origin[1]) / spacing[1]
        out[g, Z] = (centres[g, 2] - origin[2]) / spacing[2]
        out[g, U11], out[g, U22], out[g, U33] = 1 / l11, 1 / l22, 1 / l33
        out[g, U12] = -l12 / (l11 * l22)
        out[g, U23] = -l23 / (l22 * l33)
        out[g, U13] = (l12 * l23 - l13 * l22) / (l11 * l22 * l33)
        out[g, AMPLITUDE] = math.sqrt(narrow) / (l11 * l22 * l33)
        out[g, HALF_Z], out[g, HALF_Y] = cutoff * l33, cutoff * l22


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
@no_type_check
def fill(table, coefficients, cutoff, columns, first, last, volume):
    """Add all Gaussians to slices `first` to `last` of `volume` (basis, z, y, padded x)."""
    bases, slices, rows, stride = volume.shape
    k2 = f4(cutoff * cutoff)
    for g in range(table.shape[0]):
        p = table[g]
        z_low = max(first, int(math.ceil(max(p[Z] - p[HALF_Z], f4(-1)))))
        z_high = min(last, int(math.floor(min(p[Z] + p[HALF_Z], f4(slices)))) + 1)
        for z in range(z_low, z_high):
            dz = f4(z) - p[Z]
            rest_z = k2 - (p[U33] * dz) ** 2
            half = math.sqrt(max(rest_z, f4(0))) / p[U22]
            middle = p[Y] - p[U23] * dz / p[U22]
            y_low = max(0, int(math.ceil(max(middle - half, f4(-1)))))
            y_high = min(rows, int(math.floor(min(middle + half, f4(rows)))) + 1)
            for y in range(y_low, y_high):
                dy = f4(y) - p[Y]
                slope = p[U22] * dy + p[U23] * dz
                rest = max(rest_z - slope * slope, f4(0))
                shear = p[U12] * dy + p[U13] * dz
                half = math.sqrt(rest) / p[U11]
                middle = p[X] - shear / p[U11]
                low = max(0, int(math.ceil(max(middle - half, f4(-1)))))
                high = min(columns, int(math.floor(min(middle + half, f4(columns)))) + 1)
                for base in range(low, high, WIDTH):
                    along = (ramp(f4(base) - p[X])) * p[U11] + shear
                    q = along * along + (k2 - rest)
                    value = where_less(q, k2, exp_negative(minimum(q, k2) * f4(-0.5)) * p[AMPLITUDE])
                    for m in range(bases):
                        at = ((m * slices + z) * rows + y) * stride + base
                        store(volume, at, load(volume, at) + value * coefficients[g, m])
