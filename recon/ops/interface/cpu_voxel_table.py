"""Numba kernels: the numbers of divided Gaussians on a grid, and the chain rule from sums over voxels."""

import math
from typing import no_type_check

import numpy as np
from numba import njit

from recon.ops.interface.voxel_table import AMPLITUDE, PART, PART_X, U11, U12, U13, U22, U23, U33, X

VOXEL = 1 / 12  # variance of a voxel along each axis [voxel^2]
FARTHEST = 2.0**22  # voxels from the grid's corner
NEGLIGIBLE = 40.0  # exponent; exp(-40) is below the resolution of float64


@njit(inline="always", error_model="numpy")
@no_type_check
def _invert(a, out):
    """Invert a symmetric matrix, given and written as 3 x 3, and return its determinant."""
    c11 = a[1, 1] * a[2, 2] - a[1, 2] * a[1, 2]
    c12 = a[0, 2] * a[1, 2] - a[0, 1] * a[2, 2]
    c13 = a[0, 1] * a[1, 2] - a[0, 2] * a[1, 1]
    det = a[0, 0] * c11 + a[0, 1] * c12 + a[0, 2] * c13
    out[0, 0], out[0, 1], out[0, 2] = c11 / det, c12 / det, c13 / det
    out[1, 1] = (a[0, 0] * a[2, 2] - a[0, 2] * a[0, 2]) / det
    out[1, 2] = (a[0, 1] * a[0, 2] - a[0, 0] * a[1, 2]) / det
    out[2, 2] = (a[0, 0] * a[1, 1] - a[0, 1] * a[0, 1]) / det
    out[1, 0], out[2, 0], out[2, 1] = out[0, 1], out[0, 2], out[1, 2]
    return det


@njit(inline="always", error_model="numpy")
@no_type_check
def _multiply(a, b, out):
    """Multiply two matrices."""
    for i in range(3):
        for j in range(3):
            out[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]


@njit(inline="always", error_model="numpy")
@no_type_check
def _lattice_mass(x, wide, to_x, to_wide):
    """Sum a Gaussian of unit mass over all voxels, with the gradients of the sum.

    By Poisson summation 1 + 2 sum_k exp(-2 pi^2 k^T W k) cos(2 pi k.x) over half of the nearest lattice neighbours k.
    """
    mass = 1.0
    to_x[:] = 0.0
    to_wide[:] = 0.0
    for n in range(14, 27):  # (0, 0, 1), (0, 1, -1), ... (1, 1, 1)
        k = (n // 9 - 1.0, n // 3 % 3 - 1.0, n % 3 - 1.0)
        exponent, phase = 0.0, 0.0
        for i in range(3):
            phase += 2 * math.pi * k[i] * x[i]
            for j in range(3):
                exponent += 2 * math.pi**2 * k[i] * wide[i, j] * k[j]
        if exponent > NEGLIGIBLE:
            continue
        decay = 2 * math.exp(-exponent)
        wave, slope = decay * math.cos(phase), -2 * math.pi * decay * math.sin(phase)
        mass += wave
        for i in range(3):
            to_x[i] += k[i] * slope
            for j in range(3):
                to_wide[i, j] -= 2 * math.pi**2 * k[i] * k[j] * wave
    return mass


@njit(inline="always", error_model="numpy")
@no_type_check
def _measure(centre, log_scales, matrix, plane, origin, spacing, s):
    """Compute what the numbers of one Gaussian are made of.

    Parameters
    ----------
    centre, log_scales, matrix : of the Gaussian; the whitening matrix is in 1/mm
    plane : its offset and the width of its transition [standard deviations of the third axis]
    origin, spacing : of the grid, along x, y and z [mm]
    s : written, (25, 3); from row 0 the whitening matrix A in 1/voxel, 3 A^T A, 6 the covariance C, 9
        T = C (C + V)^-1 with the voxel's variance V, 12 P = (C + V)^-1, 15 its Cholesky factor; in row 18 the place
        from the middle of the voxel, 19 T a with the third row a of A, 20 (amplitude, root, mass on the lattice), 21
        the gradient of this mass in the place; from 22 that in C

    Returns
    -------
    the voxel that the centre lies in, along x, y and z
    """
    a, square, narrow, part, precision, upper = s[0:3], s[3:6], s[6:9], s[9:12], s[12:15], s[15:18]
    for i in range(3):
        for j in range(3):
            a[i, j] = matrix[i, j] * spacing[j]
    for i in range(3):
        for j in range(3):
            square[i, j] = a[0, i] * a[0, j] + a[1, i] * a[1, j] + a[2, i] * a[2, j]
            narrow[i, j] = 0.0
            for k in range(3):  # rows of A are those of the rotation over the scales
                narrow[i, j] += matrix[k, i] * matrix[k, j] * math.exp(4 * log_scales[k]) / (spacing[i] * spacing[j])
            upper[i, j] = VOXEL * square[i, j] + (1.0 if i == j else 0.0)
    det = _invert(upper, part)  # of 1 + V / C
    _multiply(part, square, precision)
    upper[0, 0] = math.sqrt(precision[0, 0])
    upper[0, 1], upper[0, 2] = precision[0, 1] / upper[0, 0], precision[0, 2] / upper[0, 0]
    upper[1, 1] = math.sqrt(precision[1, 1] - upper[0, 1] * upper[0, 1])
    upper[1, 2] = (precision[1, 2] - upper[0, 1] * upper[0, 2]) / upper[1, 1]
    upper[2, 2] = 1 / math.sqrt(narrow[2, 2] + VOXEL)
    along = 0.0
    for i in range(3):
        s[19, i] = part[i, 0] * a[2, 0] + part[i, 1] * a[2, 1] + part[i, 2] * a[2, 2]
        along += s[19, i] * a[2, i]
    voxel = (_nearest(centre[0], origin[0], spacing[0]), _nearest(centre[1], origin[1], spacing[1]),
             _nearest(centre[2], origin[2], spacing[2]))  # fmt: skip
    for i in range(3):
        s[18, i] = (centre[i] - origin[i]) / spacing[i] - voxel[i]
        narrow[i, i] += VOXEL
    s[20, 2] = _lattice_mass(s[18], narrow, s[21], s[22:25])
    for i in range(3):
        narrow[i, i] -= VOXEL
    s[20, 0], s[20, 1] = 1 / (math.sqrt(det) * s[20, 2]), math.sqrt(plane[1] * plane[1] + VOXEL * along)
    return voxel


@njit(inline="always", error_model="numpy")
@no_type_check
def _nearest(centre, origin, spacing):
    """Find the voxel nearest to a place along one axis, within `FARTHEST`."""
    return min(max(math.floor((centre - origin) / spacing + 0.5), -FARTHEST), FARTHEST)


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def fill_table(shapes, lattice, cutoff, part, written):
    """Compute the numbers of some Gaussians.

    Parameters
    ----------
    shapes : `recon.ops.interface.arrays.Shapes`
    lattice : origin and spacing of the grid, along x, y and z [mm]
    cutoff : where Gaussians end [standard deviations]
    part : first Gaussian, and one past the last
    written : `recon.ops.interface.arrays.VoxelNumbers`

    Notes
    -----
    A voxel is taken as a Gaussian of its variance V. The part of a Gaussian of covariance C in a voxel then has its
    centre of mass at C (C + V)^-1 times the voxel's offset, and the mean of the plane's transition is as for a pixel.
    """
    centres, log_scales, matrices, planes = shapes
    origin, spacing = lattice
    table, voxels, halves = written
    s = np.empty((25, 3))
    for g in range(part[0], part[1]):
        voxel = _measure(centres[g], log_scales[g], matrices[g], planes[g], origin, spacing, s)
        upper, root = s[15:18], s[20, 1]
        for i in range(3):
            voxels[g, i] = int(voxel[i])
            table[g, X + i] = s[18, i]
            table[g, PART_X + i] = s[19, i] / root
        table[g, U11], table[g, U12], table[g, U13] = upper[0, 0], upper[0, 1], upper[0, 2]
        table[g, U22], table[g, U23], table[g, U33] = upper[1, 1], upper[1, 2], upper[2, 2]
        table[g, AMPLITUDE], table[g, PART] = s[20, 0], -planes[g, 0] / root
        halves[g, 0], halves[g, 1] = cutoff / upper[2, 2], cutoff / upper[1, 1]


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def backward(shapes, lattice, sums, part, gradients):
    """Compute the gradients of some Gaussians from the sums over their voxels.

    Parameters
    ----------
    shapes, lattice : as in `fill_table`
    sums : of `recon.ops.interface.cpu_voxels.backward`
    part : first Gaussian, and one past the last
    gradients : `recon.ops.interface.arrays.ShapeGradients`, written
    """
    centres, log_scales, matrices, planes = shapes
    origin, spacing = lattice
    to_centres, to_matrices, to_planes = gradients
    s, t = np.empty((25, 3)), np.empty((15, 3))
    to_x, to_slope = t[12], t[13]
    to_part, to_precision, other, more = t[0:3], t[3:6], t[6:9], t[9:12]
    for g in range(part[0], part[1]):
        _measure(centres[g], log_scales[g], matrices[g], planes[g], origin, spacing, s)
        a, narrow, within, u = s[0:3], s[6:9], s[9:12], s[15:18]
        root, mass = s[20, 1], s[20, 2]
        w, wx, wy, wz, wxx, wxy, wxz, wyy, wyz, wzz, level, px, py, pz = sums[g]
        # the distance and the part on the positive side, both measured from the place x
        a1, a2, a3 = u[0, 0] * wx + u[0, 1] * wy + u[0, 2] * wz, u[1, 1] * wy + u[1, 2] * wz, u[2, 2] * wz
        slope_x, slope_y, slope_z = s[19] / root
        to_x[0] = u[0, 0] * a1 - slope_x * level
        to_x[1] = u[0, 1] * a1 + u[1, 1] * a2 - slope_y * level
        to_x[2] = u[0, 2] * a1 + u[1, 2] * a2 + u[2, 2] * a3 - slope_z * level
        g11, g12, g13 = (
            -(u[0, 0] * wxx + u[0, 1] * wxy + u[0, 2] * wxz),
            -(u[0, 0] * wxy + u[0, 1] * wyy + u[0, 2] * wyz),
            -(u[0, 0] * wxz + u[0, 1] * wyz + u[0, 2] * wzz),
        )
        g22, g23, g33 = -(u[1, 1] * wyy + u[1, 2] * wyz), -(u[1, 1] * wyz + u[1, 2] * wzz), -u[2, 2] * wzz
        # the plane: the numbers are -offset / root and T a / root
        to_root = (planes[g, 0] * level / root - (slope_x * px + slope_y * py + slope_z * pz)) / root
        to_planes[g, 0], to_planes[g, 1] = -level / root, to_root * planes[g, 1] / root
        to_along = VOXEL * to_root / (2 * root)
        to_slope[0], to_slope[1], to_slope[2] = px / root, py / root, pz / root
        # the Cholesky factor, whose last entry is 1 / sqrt(C + V)
        to_narrow_zz = -0.5 * g33 * u[2, 2] ** 3
        g12 -= g23 * u[0, 2] / u[1, 1]
        g13 -= g23 * u[0, 1] / u[1, 1]
        g22 -= g23 * u[1, 2] / u[1, 1]
        g12 -= g22 * u[0, 1] / u[1, 1]
        g11 -= (g12 * u[0, 1] + g13 * u[0, 2]) / u[0, 0]
        to_precision[0, 0], to_precision[1, 1], to_precision[2, 2] = 0.5 * g11 / u[0, 0], 0.5 * g22 / u[1, 1], 0.0
        to_precision[0, 1] = to_precision[1, 0] = 0.5 * g12 / u[0, 0]
        to_precision[0, 2] = to_precision[2, 0] = 0.5 * g13 / u[0, 0]
        to_precision[1, 2] = to_precision[2, 1] = 0.5 * g23 / u[1, 1]
        # T = (1 + V A^T A)^-1, P = (1 - T) / V, T a and a . T a
        for i in range(3):
            for j in range(3):
                to_part[i, j] = 0.5 * (to_slope[i] * a[2, j] + to_slope[j] * a[2, i]) + to_along * a[2, i] * a[2, j]
                to_part[i, j] -= to_precision[i, j] / VOXEL
        _multiply(within, to_part, other)
        _multiply(other, within, to_part)
        # C = (A^T A)^-1, by way of the mass on the lattice and the last entry of the Cholesky factor
        for i in range(3):
            for j in range(3):
                more[i, j] = -w / mass * s[22 + i, j]
            to_x[i] -= w / mass * s[21, i]
        more[2, 2] += to_narrow_zz
        _multiply(narrow, more, other)
        _multiply(other, narrow, more)
        # amplitude = det(1 + V A^T A)^-1/2 / mass
        for i in range(3):
            for j in range(3):
                to_precision[i, j] = -VOXEL * (to_part[i, j] + 0.5 * w * within[i, j]) - more[i, j]
        _multiply(a, to_precision, other)
        for i in range(3):
            to_centres[g, i] = to_x[i] / spacing[i]
            third = within[i, 0] * to_slope[0] + within[i, 1] * to_slope[1] + within[i, 2] * to_slope[2]
            for j in range(3):
                to_matrices[g, j, i] = 2 * other[j, i] * spacing[i]
            to_matrices[g, 2, i] += (third + 2 * to_along * s[19, i]) * spacing[i]
