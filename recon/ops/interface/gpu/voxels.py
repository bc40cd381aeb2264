"""Triton kernels: volumes of divided Gaussians, and sums over voxels for the gradients.

Numbers and sums mean what they mean in `recon.ops.interface.voxel_table` and `recon.ops.interface.cpu_voxels`; programs
own tiles and Gaussians as in `recon.ops.interface.gpu.pixels`.
"""

from typing import no_type_check

import triton
import triton.language as tl
from jaxtyping import Float32
from torch import Tensor

from recon.ops.interface.gpu.pixels import DeviceSides, part_above
from recon.ops.interface.voxel_table import SUMS
from recon.ops.tile_lists import tile_lists
from recon.ops.voxelize.gpu import Ellipsoids, value_in_voxels

_TILE = (4, 8, 8)  # edges of a tile (z, y, x)
_BLOCK = 128  # voxels at a time of a Gaussian's program
# Sizes that make no kernel of their own: a sum that is compiled for one slice may be rounded in another order.
_SHAPE = ("layers", "rows", "columns", "down", "across")


@triton.jit
@no_type_check
def _argument(p, x, y, z):
    """Compute the argument of Phi in voxels x, y, z from the centre."""
    return tl.load(p + 10) + tl.load(p + 11) * x + tl.load(p + 12) * y + tl.load(p + 13) * z


@triton.jit(do_not_specialize=_SHAPE)
@no_type_check
def _forward(
    numbers, places, below, step, members, starts, out, layers, rows, columns, down, across, bases, k2,
    DEEP: tl.constexpr, HIGH: tl.constexpr, WIDE: tl.constexpr, PADDED: tl.constexpr,
):  # fmt: skip
    """Compute the voxels (basis, z, y, x) of a tile."""
    tile, voxel, basis = tl.program_id(0), tl.arange(0, DEEP * HIGH * WIDE), tl.arange(0, PADDED)
    layer = tile // (down * across) * DEEP + voxel // (HIGH * WIDE)
    row = tile // across % down * HIGH + voxel // WIDE % HIGH
    column = tile % across * WIDE + voxel % WIDE
    total = tl.zeros((DEEP * HIGH * WIDE, PADDED), dtype=tl.float32)
    for k in range(tl.load(starts + tile), tl.load(starts + tile + 1)):
        g = tl.load(members + k)
        value, x, y, z = value_in_voxels(numbers + g * 14, places + g * 9, column, row, layer, k2)
        part, _ = part_above(_argument(numbers + g * 14, x, y, z))
        low = tl.load(below + g * bases + basis, mask=basis < bases, other=0.0)
        more = tl.load(step + g * bases + basis, mask=basis < bases, other=0.0)
        total += value[:, None] * low[None] + (value * part)[:, None] * more[None]
    known = ((layer < layers) & (row < rows) & (column < columns))[:, None] & (basis < bases)[None]
    place = ((basis[None].to(tl.int64) * layers + layer[:, None]) * rows + row[:, None]) * columns + column[:, None]
    tl.store(out + place, total, mask=known)


@triton.jit
@no_type_check
def _backward(
    numbers, places, below, step, cotangent, sums, to_below, to_step, layers, rows, columns, bases, k2,
    BLOCK: tl.constexpr, PADDED: tl.constexpr,
):  # fmt: skip
    """Sum over the voxels of a Gaussian (gaussian, 14); also the gradients in both sides (gaussian, basis)."""
    g, basis = tl.program_id(0).to(tl.int64), tl.arange(0, PADDED)
    place = places + 9 * g
    first_layer, first_row, first_column = tl.load(place + 3), tl.load(place + 5), tl.load(place + 7)
    width = tl.load(place + 8) - first_column
    area = (tl.load(place + 6) - first_row) * width
    voxels = (tl.load(place + 4) - first_layer) * area
    low = tl.load(below + g * bases + basis, mask=basis < bases, other=0.0)
    more = tl.load(step + g * bases + basis, mask=basis < bases, other=0.0)
    zero = tl.zeros((BLOCK,), dtype=tl.float32)
    w, wx, wy, wz, t0, tx, ty, tz = zero, zero, zero, zero, zero, zero, zero, zero
    wxx, wxy, wxz, wyy, wyz, wzz = zero, zero, zero, zero, zero, zero
    to_low = tl.zeros((BLOCK, PADDED), dtype=tl.float32)
    to_more = tl.zeros((BLOCK, PADDED), dtype=tl.float32)
    for begin in range(0, voxels, BLOCK):
        voxel = begin + tl.arange(0, BLOCK)
        layer, rest = first_layer + voxel // area, voxel % area
        row, column = first_row + rest // width, first_column + rest % width
        value, x, y, z = value_in_voxels(numbers + 14 * g, place, column, row, layer, k2)
        value = tl.where(voxel < voxels, value, 0.0)
        part, density = part_above(_argument(numbers + 14 * g, x, y, z))
        to = ((basis[None].to(tl.int64) * layers + layer[:, None]) * rows + row[:, None]) * columns + column[:, None]
        incoming = tl.load(cotangent + to, mask=(voxel < voxels)[:, None] & (basis < bases)[None], other=0.0)
        to_low += incoming * value[:, None]
        to_more += incoming * (part * value)[:, None]
        to_part = tl.sum(incoming * more[None], axis=1)
        to_value = (tl.sum(incoming * low[None], axis=1) + to_part * part) * value
        to_at = to_part * value * density
        w, wx, wy, wz = w + to_value, wx + to_value * x, wy + to_value * y, wz + to_value * z
        wxx, wxy, wxz = wxx + to_value * x * x, wxy + to_value * x * y, wxz + to_value * x * z
        wyy, wyz, wzz = wyy + to_value * y * y, wyz + to_value * y * z, wzz + to_value * z * z
        t0, tx, ty, tz = t0 + to_at, tx + to_at * x, ty + to_at * y, tz + to_at * z
    sums += 14 * g
    tl.store(sums, tl.sum(w, 0))
    tl.store(sums + 1, tl.sum(wx, 0))
    tl.store(sums + 2, tl.sum(wy, 0))
    tl.store(sums + 3, tl.sum(wz, 0))
    tl.store(sums + 4, tl.sum(wxx, 0))
    tl.store(sums + 5, tl.sum(wxy, 0))
    tl.store(sums + 6, tl.sum(wxz, 0))
    tl.store(sums + 7, tl.sum(wyy, 0))
    tl.store(sums + 8, tl.sum(wyz, 0))
    tl.store(sums + 9, tl.sum(wzz, 0))
    tl.store(sums + 10, tl.sum(t0, 0))
    tl.store(sums + 11, tl.sum(tx, 0))
    tl.store(sums + 12, tl.sum(ty, 0))
    tl.store(sums + 13, tl.sum(tz, 0))
    tl.store(to_below + g * bases + basis, tl.sum(to_low, 0), mask=basis < bases)
    tl.store(to_step + g * bases + basis, tl.sum(to_more, 0), mask=basis < bases)


def forward(
    ellipsoids: Ellipsoids, sides: DeviceSides, shape: tuple[int, int, int], cutoff: float
) -> Float32[Tensor, "basis z y x"]:
    """Sum all Gaussians, times the coefficients of their sides.

    Parameters
    ----------
    ellipsoids : Gaussians on the grid, with the numbers of `recon.ops.interface.voxel_table`
    sides : coefficients
    shape : of the grid (z, y, x)
    cutoff : where a Gaussian ends [standard deviations]

    Returns
    -------
    volume of each basis
    """
    bases = sides.below.shape[1]
    deep, down, across = (triton.cdiv(size, edge) for size, edge in zip(shape, _TILE, strict=True))
    out = sides.below.new_empty((bases, *shape))
    members, starts = tile_lists(ellipsoids.places[:, 3:].long(), _TILE, (deep, down, across))
    if out.numel():
        _forward[(deep * down * across,)](
            *ellipsoids, *sides, members, starts, out, *shape, down, across, bases, cutoff**2,
            *_TILE, triton.next_power_of_2(bases),
        )  # fmt: skip
    return out


def backward(
    ellipsoids: Ellipsoids, sides: DeviceSides, cotangent: Float32[Tensor, "basis z y x"], cutoff: float
) -> tuple[Float32[Tensor, "gaussian 14"], Float32[Tensor, "gaussian basis"], Float32[Tensor, "gaussian basis"]]:
    """Sum over the voxels of every Gaussian.

    Parameters
    ----------
    ellipsoids : Gaussians on the grid, with the numbers of `recon.ops.interface.voxel_table`
    sides : coefficients
    cotangent : gradient in the volume; contiguous
    cutoff : where a Gaussian ends [standard deviations]

    Returns
    -------
    sums as in `recon.ops.interface.cpu_voxels.backward`, and the gradients below and in the step
    """
    (n, bases), (_, layers, rows, columns) = sides.below.shape, cotangent.shape
    sums = sides.below.new_empty((n, SUMS))
    to_below, to_step = (sides.below.new_empty((n, bases)) for _ in sides)
    if to_below.numel():
        _backward[(n,)](
            *ellipsoids, *sides, cotangent, sums, to_below, to_step, layers, rows, columns, bases, cutoff**2,
            _BLOCK, triton.next_power_of_2(bases),
        )  # fmt: skip
    return sums, to_below, to_step
