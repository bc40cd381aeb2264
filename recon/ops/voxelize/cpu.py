"""Numba kernels of the voxelizer.

`shapes` reduces a Gaussian to 15 numbers in voxel units; `fill` adds all Gaussians to a slab of slices, each voxel in
the order of the Gaussians; `recon.ops.voxelize.backward` computes the gradients. In voxels (x, y, z) from the centre
the exponent is half of (u11 x + u12 y + u13 z)^2 + (u22 y + u23 z)^2 + (u33 z)^2, and a Gaussian is cut off where this
sum exceeds cutoff^2. A centre is stored as the voxel that contains it and the offset from that voxel's centre, so that
part of a grid gives the same rounding as the whole grid.
"""

import math
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float64
from numba import njit

from phantomgen.ops.simd import WIDTH, count_from, exp_negative, load, minimum, one_more, splat, store, where_less
from recon.ops.rasterize.footprint_table import NARROWEST, NEGLIGIBLE
from recon.ops.rounding import round_down, round_up
from spectra.ops.min_max import larger, smaller

X, Y, Z, U11, U12, U13, U22, U23, U33, AMPLITUDE, HALF_Z, HALF_Y, VOXEL_X, VOXEL_Y, VOXEL_Z = range(15)
SHAPE_SIZE = 15
FARTHEST = 2.0**22  # voxels from the grid's corner; integers are exact in float32 up to four times as much
SLACK = 0.01  # voxels by which rows are longer than the ellipsoid at either end; `where_less` cuts exactly
f4 = np.float32


class VoxelSampling(NamedTuple):
    """Voxels of a grid, and how Gaussians are sampled on them.

    Parameters
    ----------
    origin : centre of the first voxel (x, y, z) [mm]
    spacing : distance between voxel centres (x, y, z) [mm]
    box : variance that averaging over a voxel adds along each axis [voxel^2]
    cutoff : where a Gaussian ends [standard deviations]
    """

    origin: Float64[np.ndarray, "3"]
    spacing: Float64[np.ndarray, "3"]
    box: float
    cutoff: float


@njit(inline="always")
@no_type_check
def lattice_mass(x, c, box, slopes):
    """Sum a density of unit mass over all voxels.

    Parameters
    ----------
    x : offset of the centre from its voxel [voxels], (3,)
    c : covariance, that of the voxel included [voxel^2], (3, 3)
    box : variance that the voxel adds [voxel^2]; where it is below that of a whole voxel, the sum is 1
    slopes : written, (9,): derivatives of the sum in x, y, z and in the covariance's entries 11, 12, 13, 22, 23, 33
        (half of both for mixed ones)

    Returns
    -------
    1 + 2 sum_k exp(-2 pi^2 k^T C k) cos(2 pi k.x) over half of the nearest lattice neighbours k (Poisson summation)
    """
    mass = 1.0
    for i in range(9):
        slopes[i] = 0.0
    if box < NARROWEST:  # voxels that do not average have no mass to keep
        return mass
    for n in range(14, 27):
        k0, k1, k2 = n // 9 - 1.0, n // 3 % 3 - 1.0, n % 3 - 1.0
        square = k0 * (k0 * c[0, 0] + 2 * k1 * c[0, 1] + 2 * k2 * c[0, 2])
        square += k1 * (k1 * c[1, 1] + 2 * k2 * c[1, 2]) + k2 * k2 * c[2, 2]
        exponent = 2 * math.pi**2 * square
        if exponent < NEGLIGIBLE:
            decay, phase = 2 * math.exp(-exponent), 2 * math.pi * (k0 * x[0] + k1 * x[1] + k2 * x[2])
            wave, slope = decay * math.cos(phase), -2 * math.pi * decay * math.sin(phase)
            mass += wave
            slopes[0] += k0 * slope
            slopes[1] += k1 * slope
            slopes[2] += k2 * slope
            wave *= -2 * math.pi**2
            slopes[3] += k0 * k0 * wave
            slopes[4] += k0 * k1 * wave
            slopes[5] += k0 * k2 * wave
            slopes[6] += k1 * k1 * wave
            slopes[7] += k1 * k2 * wave
            slopes[8] += k2 * k2 * wave
    return mass


@njit(inline="always")
@no_type_check
def place(centre, a, sampling, norms, c, x, voxel):
    """Express a Gaussian in voxels.

    Parameters
    ----------
    centre : [mm], (3,)
    a : whitening matrix [1/mm], (3, 3)
    sampling : `VoxelSampling`
    norms : written, squared lengths of the rows of the matrix [1/mm^2], (3,)
    c : written, covariance, that of the voxel included [voxel^2], (3, 3)
    x : written, offset of the centre from its voxel [voxels], (3,)
    voxel : written, number of the voxel that contains the centre, (3,)

    Returns
    -------
    determinant of the covariance without that of the voxel [voxel^6]
    """
    origin, spacing, box = sampling.origin, sampling.spacing, sampling.box
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
        x[i] = (centre[i] - origin[i]) / spacing[i]
        voxel[i] = min(max(math.floor(x[i] + 0.5), -FARTHEST), FARTHEST)
        x[i] -= voxel[i]
    return narrow


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def shapes(gaussians, sampling, first, last, out):
    """Compute the 15 numbers of some Gaussians.

    Parameters
    ----------
    gaussians : `recon.ops.arguments.GaussianArrays`; with the whitening matrix A the covariance is (A^T A)^-1
    sampling : `VoxelSampling`
    first, last : Gaussians from `first` to one before `last`
    out : written, (gaussian, 15)
    """
    box, cutoff = sampling.box, sampling.cutoff
    c, x, voxel, norms, slopes = np.empty((3, 3)), np.empty(3), np.empty(3), np.empty(3), np.empty(9)
    for g in range(first, last):
        narrow = place(gaussians.centres[g], gaussians.matrices[g], sampling, norms, c, x, voxel)
        # inverse of the Cholesky factor of C, from the last axis to the first: C = L L^T with L upper triangular
        l33 = math.sqrt(c[2, 2])
        l23, l13 = c[1, 2] / l33, c[0, 2] / l33
        l22 = math.sqrt(c[1, 1] - l23 * l23)
        l12 = (c[0, 1] - l13 * l23) / l22
        l11 = math.sqrt(c[0, 0] - l12 * l12 - l13 * l13)
        out[g, X], out[g, Y], out[g, Z] = x[0], x[1], x[2]
        out[g, VOXEL_X], out[g, VOXEL_Y], out[g, VOXEL_Z] = voxel[0], voxel[1], voxel[2]
        out[g, U11], out[g, U22], out[g, U33] = 1 / l11, 1 / l22, 1 / l33
        out[g, U12] = -l12 / (l11 * l22)
        out[g, U23] = -l23 / (l22 * l33)
        out[g, U13] = (l12 * l23 - l13 * l22) / (l11 * l22 * l33)
        out[g, AMPLITUDE] = math.sqrt(narrow) / (l11 * l22 * l33 * lattice_mass(x, c, box, slopes))
        out[g, HALF_Z], out[g, HALF_Y] = cutoff * l33, cutoff * l22


@njit(inline="always")
@no_type_check
def span(middle, half, voxel, first, last):
    """Find the indices within a distance of a point, along one axis.

    Parameters
    ----------
    middle : the point, measured from `voxel` [voxels]
    half : the distance [voxels]
    voxel : number of a voxel
    first, last : indices from `first` to one before `last` are allowed

    Returns
    -------
    first index, and one past the last
    """
    low = smaller(larger(middle - half - f4(SLACK), f4(first - voxel)), f4(last - voxel))
    high = smaller(larger(middle + half + f4(SLACK), f4(first - voxel - 1)), f4(last - voxel - 1))
    return voxel + round_up(low), voxel + round_down(high) + 1


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
@no_type_check
def fill(bases, table, coefficients, cutoff, first, last, volume):
    """Add all Gaussians to some slices of a volume.

    Parameters
    ----------
    bases : tuple with one entry per basis; its length is known when numba compiles, which unrolls the loops over bases
    table : numbers of the Gaussians, (gaussian, 15)
    coefficients : (gaussian, basis)
    cutoff : where a Gaussian ends [standard deviations]
    first, last : slices from `first` to one before `last`
    volume : added to, (basis, z, y, x and `WIDTH` voxels of padding)
    """
    _, slices, rows, stride = volume.shape
    columns = stride - WIDTH
    k2 = f4(cutoff * cutoff)
    for g in range(table.shape[0]):
        p = table[g]
        nx, ny, nz = int(p[VOXEL_X]), int(p[VOXEL_Y]), int(p[VOXEL_Z])
        for z in range(*span(p[Z], p[HALF_Z], nz, first, last)):
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
                middle = p[X] - shear / p[U11]
                low, high = span(middle, half, nx, 0, columns)
                for base in range(low, high, WIDTH):
                    along = (count_from(base - nx) - splat(p[X])) * p[U11] + shear
                    q = along * along + (k2 - rest)
                    value = where_less(q, k2, exp_negative(minimum(q, k2) * f4(-0.5)) * p[AMPLITUDE])
                    for m in range(len(bases)):
                        at = ((m * slices + z) * rows + y) * stride + base
                        store(volume, at, load(volume, at) + value * coefficients[g, m])
