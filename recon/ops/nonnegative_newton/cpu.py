"""Numba kernels of the non-negative Newton steps."""

from math import sqrt
from typing import no_type_check

import numpy as np
from numba import njit

from phantomgen.ops.kernel_decorators import inlined
from recon.ops.arguments import TINY

SINGULAR = 1e-30  # of the floor; smallest pivot of a block, which rounding could make 0 or negative


@inlined
@no_type_check
def _pair(m, n, bases):
    """Find the place of entry (m, n) in an upper triangle that is stored row by row."""
    low, high = min(m, n), max(m, n)
    return low * bases - low * (low - 1) // 2 + high - low


@inlined
@no_type_check
def _hold(matrix, held, wanted, factor, force):
    """Write the forces that hold coefficients at 0: the block `held` of the matrix, by Cholesky; 0 for the others."""
    bases = wanted.size
    for i in range(bases):
        force[i] = 0.0
        if held[i] == 0.0:
            continue
        s, square = wanted[i], matrix[i, i]
        for j in range(i):
            if held[j] == 0.0:
                continue
            product = matrix[i, j]
            for k in range(j):
                if held[k] > 0.0:
                    product -= factor[i, k] * factor[j, k]
            factor[i, j] = product / factor[j, j]
            square -= factor[i, j] * factor[i, j]
            s -= factor[i, j] * force[j]
        factor[i, i] = sqrt(max(square, TINY))
        force[i] = s / factor[i, i]
    for i in range(bases - 1, -1, -1):
        if held[i] > 0.0:
            s = force[i]
            for k in range(i + 1, bases):
                if held[k] > 0.0:
                    s -= factor[k, i] * force[k]
            force[i] = s / factor[i, i]


@inlined
@no_type_check
def _pivot(matrix, wanted, held, factor, force, nearest):
    """Write the nearest non-negative point by block principal pivoting.

    Coefficients that become negative are held at 0, and those whose force is not positive are released, until the set
    of held coefficients no longer changes.
    """
    bases = wanted.size
    for m in range(bases):
        held[m] = 1.0 if wanted[m] < 0.0 else 0.0
    for _ in range(bases):
        _hold(matrix, held, wanted, factor, force)
        changed = False
        for m in range(bases):
            value = wanted[m]
            for n in range(bases):
                value -= matrix[m, n] * force[n]
            is_held = held[m] > 0.0
            nearest[m] = 0.0 if is_held else max(value, 0.0)
            hold = force[m] <= 0.0 if is_held else value < 0.0
            changed = changed or hold != is_held
            held[m] = 1.0 if hold else 0.0
        if not changed:
            break


@inlined
@no_type_check
def _forces(block, right):
    """Solve a symmetric 3 x 3 system by Cramer's rule; `block` is the upper triangle row by row."""
    a, b, c, d, e, f = block
    u, v, w = right
    p, q, r = d * f - e * e, c * e - b * f, b * e - c * d
    s, t, o = a * f - c * c, b * c - a * e, a * d - b * b
    scale = 1.0 / (a * p + b * q + c * r)
    return scale * (p * u + q * v + r * w), scale * (q * u + s * v + t * w), scale * (r * u + t * v + o * w)


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def _pivot_three(inverse, first, last, out):
    """Do what `_pivot` does for three bases, without branches, so that vector instructions handle many voxels."""
    for voxel in range(np.uint64(first), np.uint64(last)):
        a, b, c = float(inverse[0, voxel]), float(inverse[1, voxel]), float(inverse[2, voxel])
        d, e, f = float(inverse[3, voxel]), float(inverse[4, voxel]), float(inverse[5, voxel])
        u, v, w = float(out[0, voxel]), float(out[1, voxel]), float(out[2, voxel])
        i, j, k = u < 0.0, v < 0.0, w < 0.0
        x, y, z = u, v, w
        for _ in range(3):
            held = (
                a if i else 1.0, b if i & j else 0.0, c if i & k else 0.0,
                d if j else 1.0, e if j & k else 0.0, f if k else 1.0,
            )  # fmt: skip
            p, q, r = _forces(held, (u if i else 0.0, v if j else 0.0, w if k else 0.0))
            x, y, z = u - a * p - b * q - c * r, v - b * p - d * q - e * r, w - c * p - e * q - f * r
            free_x, free_y, free_z = 0.0 if i else x, 0.0 if j else y, 0.0 if k else z
            i, j, k = (p if i else x) < 0.0, (q if j else y) < 0.0, (r if k else z) < 0.0
            x, y, z = free_x, free_y, free_z
        out[0, voxel], out[1, voxel], out[2, voxel] = max(x, 0.0), max(y, 0.0), max(z, 0.0)


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def nonnegative_newton_step(volumes, inverse, cotangents, bounded, first, last, room, out):
    """Compute the steps of some voxels.

    Steps are computed without the bound first; those that end below it are computed again.

    Parameters
    ----------
    volumes : start, (basis, voxel)
    inverse : inverse of each voxel's block, (pair, voxel)
    cotangents : gradient at the start, (basis, voxel)
    bounded : whether x >= 0 is required
    first, last : voxels from `first` to one before `last`
    room : scratch, (2 basis + 4, basis)
    out : written, (basis, voxel)
    """
    bases = volumes.shape[0]
    factor, matrix = room[:bases], room[bases : 2 * bases]
    wanted, held, force, nearest = room[2 * bases], room[2 * bases + 1], room[2 * bases + 2], room[2 * bases + 3]
    for m in range(bases):
        for voxel in range(np.uint64(first), np.uint64(last)):
            out[m, voxel] = volumes[m, voxel]
        for n in range(bases):
            pair = _pair(m, n, bases)
            for voxel in range(np.uint64(first), np.uint64(last)):
                out[m, voxel] -= inverse[pair, voxel] * cotangents[n, voxel]
    if not bounded:
        return
    if bases == 3:
        _pivot_three(inverse, first, last, out)
        return
    for voxel in range(np.uint64(first), np.uint64(last)):
        negative = False
        for m in range(bases):
            negative = negative or out[m, voxel] < 0.0
        if not negative:
            continue
        for m in range(bases):
            wanted[m] = out[m, voxel]
            for n in range(m, bases):
                matrix[m, n] = matrix[n, m] = inverse[_pair(m, n, bases), voxel]
        _pivot(matrix, wanted, held, factor, force, nearest)
        for m in range(bases):
            out[m, voxel] = nearest[m]


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def inverse_blocks(blocks, floor, first, last, room, out):
    """Compute the inverse blocks of some voxels.

    Parameters
    ----------
    blocks : upper triangles row by row, (pair, voxel)
    floor : added to the diagonal, (basis,)
    first, last : voxels from `first` to one before `last`
    room : scratch, (2, basis, basis)
    out : written, (pair, voxel)
    """
    bases = floor.size
    factor, root = room[0], room[1]
    for voxel in range(np.uint64(first), np.uint64(last)):
        for i in range(bases):
            for j in range(i + 1):
                s = float(blocks[_pair(i, j, bases), voxel]) + (floor[i] if i == j else 0.0)
                for k in range(j):
                    s -= factor[i, k] * factor[j, k]
                factor[i, j] = sqrt(max(s, SINGULAR * floor[i])) if i == j else s / factor[j, j]
        for j in range(bases):
            for i in range(j, bases):
                s = 1.0 if i == j else 0.0
                for k in range(j, i):
                    s -= factor[i, k] * root[k, j]
                root[i, j] = s / factor[i, i]
        for i in range(bases):
            for j in range(i, bases):
                s = 0.0
                for k in range(j, bases):
                    s += root[k, i] * root[k, j]
                out[_pair(i, j, bases), voxel] = s
