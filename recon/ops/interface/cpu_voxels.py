"""Numba kernels: volumes of divided Gaussians, and sums over voxels for the gradients."""

import math
from typing import no_type_check

import numpy as np
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
from recon.ops.interface.cpu import FAR, normal, side_of
from recon.ops.interface.voxel_table import (
    AMPLITUDE,
    PART,
    PART_X,
    PART_Y,
    PART_Z,
    U11,
    U12,
    U13,
    U22,
    U23,
    U33,
    X,
    Y,
    Z,
)
from recon.ops.voxelize.cpu import span
from spectra.ops.min_max import larger

f4 = np.float32


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
@no_type_check
def fill(bases, numbers, sides, cutoff, columns, part, volume):
    """Add all Gaussians to some slices of a volume.

    Parameters
    ----------
    bases : a tuple as long as there are bases
    numbers, sides : `VoxelNumbers` and `Sides` of all Gaussians
    cutoff : where Gaussians end [standard deviations]
    columns : voxels along x
    part : first slice, and one past the last
    volume : (basis, z, y, padded x), in place [1/mm]
    """
    table, voxels, halves = numbers
    below, step = sides
    first, last = part
    _, slices, rows, stride = volume.shape
    k2 = f4(cutoff * cutoff)
    for g in range(table.shape[0]):
        p = table[g]
        nx, ny, nz = voxels[g, 0], voxels[g, 1], voxels[g, 2]
        for z in range(*span(p[Z], halves[g, 0], nz, first, last)):
            dz = f4(z - nz) - p[Z]
            high_z = p[U33] * dz
            rest_z = k2 - high_z * high_z
            half = math.sqrt(larger(rest_z, f4(0))) / p[U22]
            y0, y1 = span(p[Y] - p[U23] * dz / p[U22], half, ny, 0, rows)
            row = f4(y0 - ny - 1)
            for y in range(y0, y1):
                row = one_more(row)
                dy = row - p[Y]
                slope = p[U22] * dy + p[U23] * dz
                rest = larger(rest_z - slope * slope, f4(0))
                shear = p[U12] * dy + p[U13] * dz
                half = math.sqrt(rest) / p[U11]
                low, high = span(p[X] - shear / p[U11], half, nx, 0, columns)
                level = p[PART] + p[PART_Y] * dy + p[PART_Z] * dz
                from_x, to_x = f4(low - nx) - p[X], f4(high - 1 - nx) - p[X]
                side = side_of(from_x * p[PART_X] + level, to_x * p[PART_X] + level)
                for base in range(low, high, WIDTH):
                    x = count_from(base - nx) - splat(p[X])
                    along = x * p[U11] + shear
                    q = along * along + (k2 - rest)
                    value = where_less(q, k2, exp_negative(minimum(q, k2) * f4(-0.5)) * p[AMPLITUDE])
                    if side != 0:
                        for m in range(len(bases)):
                            at = ((m * slices + z) * rows + y) * stride + base
                            one_side = below[g, m] + step[g, m] if side > 0 else below[g, m]
                            store(volume, at, load(volume, at) + value * one_side)
                        continue
                    upper = normal(x * p[PART_X] + level)[0] * value
                    for m in range(len(bases)):
                        at = ((m * slices + z) * rows + y) * stride + base
                        store(volume, at, load(volume, at) + value * below[g, m] + upper * step[g, m])


@njit(forceinline=True, fastmath=True, error_model="numpy")
@no_type_check
def _gather(bases, p, place, sides, cotangent, k2, columns, out):
    """Sums over one Gaussian's voxels, one row of voxels at a time: see `backward` for their meaning."""
    voxel, halves = place
    below, step = sides
    sums, to_below, to_step = out
    _, slices, rows, stride = cotangent.shape
    nx, ny, nz = voxel[0], voxel[1], voxel[2]
    zero = splat(f4(0))
    w0, wx, wy, wz, wxx, wxy, wxz, wyy, wyz, wzz = zero, zero, zero, zero, zero, zero, zero, zero, zero, zero
    t0, tx, ty, tz = zero, zero, zero, zero
    for z in range(*span(p[Z], halves[0], nz, 0, slices)):
        dz = f4(z - nz) - p[Z]
        high_z = p[U33] * dz
        rest_z = k2 - high_z * high_z
        half = math.sqrt(larger(rest_z, f4(0))) / p[U22]
        y0, y1 = span(p[Y] - p[U23] * dz / p[U22], half, ny, 0, rows)
        row = f4(y0 - ny - 1)
        for y in range(y0, y1):
            row = one_more(row)
            dy = row - p[Y]
            slope = p[U22] * dy + p[U23] * dz
            rest = larger(rest_z - slope * slope, f4(0))
            shear = p[U12] * dy + p[U13] * dz
            half = math.sqrt(rest) / p[U11]
            low, high = span(p[X] - shear / p[U11], half, nx, 0, columns)
            level = p[PART] + p[PART_Y] * dy + p[PART_Z] * dz
            from_x, to_x = f4(low - nx) - p[X], f4(high - 1 - nx) - p[X]
            side = side_of(from_x * p[PART_X] + level, to_x * p[PART_X] + level)
            r0, rx, rxx, s0, sx = zero, zero, zero, zero, zero
            for base in range(low, high, WIDTH):
                x = count_from(base - nx) - splat(p[X])
                along = x * p[U11] + shear
                q = along * along + (k2 - rest)
                value = where_less(q, k2, exp_negative(minimum(q, k2) * f4(-0.5)) * p[AMPLITUDE])
                if side != 0:
                    to_value = zero
                    for m in range(len(bases)):
                        incoming = load(cotangent, ((m * slices + z) * rows + y) * stride + base)
                        one_side = below[m] + step[m] if side > 0 else below[m]
                        to_value = to_value + incoming * one_side
                        store(to_below, m * WIDTH, load(to_below, m * WIDTH) + incoming * value)
                        if side > 0:
                            store(to_step, m * WIDTH, load(to_step, m * WIDTH) + incoming * value)
                    to_value = to_value * value
                    across = to_value * x
                    r0, rx, rxx = r0 + to_value, rx + across, rxx + across * x
                    continue
                at = x * p[PART_X] + level
                part, density = normal(at)
                shared = part * value
                to_value, to_part = zero, zero
                for m in range(len(bases)):
                    incoming = load(cotangent, ((m * slices + z) * rows + y) * stride + base)
                    to_value = to_value + incoming * below[m]
                    to_part = to_part + incoming * step[m]
                    store(to_below, m * WIDTH, load(to_below, m * WIDTH) + incoming * value)
                    store(to_step, m * WIDTH, load(to_step, m * WIDTH) + incoming * shared)
                to_value = (to_value + to_part * part) * value
                to_part = where_less(at * at, f4(FAR), to_part * value * density)
                across = to_value * x
                r0, rx, rxx = r0 + to_value, rx + across, rxx + across * x
                s0, sx = s0 + to_part, sx + to_part * x
            w0, wx, wxx = w0 + r0, wx + rx, wxx + rxx
            ry, rz = r0 * dy, r0 * dz
            wy, wz = wy + ry, wz + rz
            wxy, wxz = wxy + rx * dy, wxz + rx * dz
            wyy, wyz, wzz = wyy + ry * dy, wyz + ry * dz, wzz + rz * dz
            t0, tx, ty, tz = t0 + s0, tx + sx, ty + s0 * dy, tz + s0 * dz
    sums[0], sums[1], sums[2], sums[3], sums[4] = total(w0), total(wx), total(wy), total(wz), total(wxx)
    sums[5], sums[6], sums[7], sums[8], sums[9] = total(wxy), total(wxz), total(wyy), total(wyz), total(wzz)
    sums[10], sums[11], sums[12], sums[13] = total(t0), total(tx), total(ty), total(tz)


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def backward(bases, numbers, sides, cotangent, cutoff, columns, part, gradients):
    """Sum over the voxels of some Gaussians.

    Parameters
    ----------
    bases : a tuple as long as there are bases
    numbers, sides : `VoxelNumbers` and `Sides` of all Gaussians
    cotangent : gradient in the volume
    cutoff : where Gaussians end [standard deviations]
    columns : voxels along x
    part : first Gaussian, and one past the last
    gradients : `SideGradients`, written

    Notes
    -----
    With v the value of a voxel, w = v times the gradient in that value and t the gradient in the argument of Phi, the
    sums are w (1, x, y, z, xx, xy, xz, yy, yz, zz) and t (1, x, y, z).
    """
    table, voxels, halves = numbers
    below, step = sides
    sums, to_below, to_step = gradients
    k2 = f4(cutoff * cutoff)
    lanes, more = np.empty(len(bases) * WIDTH, np.float32), np.empty(len(bases) * WIDTH, np.float32)
    for g in range(part[0], part[1]):
        lanes[:] = f4(0)
        more[:] = f4(0)
        out, place = (sums[g], lanes, more), (voxels[g], halves[g])
        _gather(bases, table[g], place, (below[g], step[g]), cotangent, k2, columns, out)
        for m in range(len(bases)):
            to_below[g, m] = total(load(lanes, m * WIDTH))
            to_step[g, m] = total(load(more, m * WIDTH))
