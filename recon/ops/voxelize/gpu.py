"""Triton kernels of the voxelizer: Gaussians to voxels, and voxels back to Gaussians.

A program of `_forward` owns a tile of voxels and adds the Gaussians that its list names, in their order; a program of
`_backward` owns a Gaussian and sums over its voxels. Nothing is added atomically, so that results repeat bit by bit.
In voxels (x, y, z) from the centre the exponent is half of (u11 x + u12 y + u13 z)^2 + (u22 y + u23 z)^2 + (u33 z)^2,
as in `recon.ops.voxelize.cpu`. The tests run the kernels in Triton's interpreter, and compile them for GPUs.
"""

from typing import NamedTuple, no_type_check

import torch
import triton
import triton.language as tl
from jaxtyping import Float32, Int32
from torch import Tensor

from recon.ops.tile_lists import tile_lists

SUMS = 10  # of w, w (x, y, z) and w (xx, xy, xz, yy, yz, zz), as in `recon.ops.voxelize.backward`
_TILE = (4, 8, 8)  # edges of a tile (z, y, x)
_BLOCK = 128  # voxels at a time of a Gaussian's program
# Sizes that make no kernel of their own: a sum that is compiled for one slice may be rounded in another order.
_SHAPE = ("layers", "rows", "columns", "down", "across")


class Ellipsoids(NamedTuple):
    """Gaussians on a grid.

    Parameters
    ----------
    numbers : offset x, y, z from the voxel; u11, u12, u13, u22, u23, u33; amplitude; more of divided Gaussians
    places : voxel x, y, z; then first index and one past the last along z, y and x
    """

    numbers: Float32[Tensor, "gaussian number"]
    places: Int32[Tensor, "gaussian 9"]


@triton.jit
@no_type_check
def value_in_voxels(p, place, column, row, layer, k2):
    """Compute the value of a Gaussian in voxels, and their places (x, y, z) from its centre.

    Parameters
    ----------
    p, place : pointers to numbers and places of the Gaussian, see `Ellipsoids`
    column, row, layer : the voxels
    k2 : square of the cutoff

    Returns
    -------
    value, x, y and z
    """
    x = (column - tl.load(place)).to(tl.float32) - tl.load(p)
    y = (row - tl.load(place + 1)).to(tl.float32) - tl.load(p + 1)
    z = (layer - tl.load(place + 2)).to(tl.float32) - tl.load(p + 2)
    along = x * tl.load(p + 3) + y * tl.load(p + 4) + z * tl.load(p + 5)
    across, up = y * tl.load(p + 6) + z * tl.load(p + 7), z * tl.load(p + 8)
    q = along * along + across * across + up * up
    # the box as well, so that what rounding lets pass beyond it does not depend on the tiles
    inside = (q < k2) & (layer >= tl.load(place + 3)) & (layer < tl.load(place + 4)) & (row >= tl.load(place + 5))
    inside = inside & (row < tl.load(place + 6)) & (column >= tl.load(place + 7)) & (column < tl.load(place + 8))
    return tl.where(inside, tl.exp(-0.5 * tl.where(inside, q, 0.0)) * tl.load(p + 9), 0.0), x, y, z


@triton.jit(do_not_specialize=_SHAPE)
@no_type_check
def _forward(
    numbers, places, coefficients, members, starts, out, layers, rows, columns, down, across, bases, k2,
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
        value, _, _, _ = value_in_voxels(numbers + g * 10, places + g * 9, column, row, layer, k2)
        total += value[:, None] * tl.load(coefficients + g * bases + basis, mask=basis < bases, other=0.0)[None]
    known = ((layer < layers) & (row < rows) & (column < columns))[:, None] & (basis < bases)[None]
    place = ((basis[None].to(tl.int64) * layers + layer[:, None]) * rows + row[:, None]) * columns + column[:, None]
    tl.store(out + place, total, mask=known)


@triton.jit
@no_type_check
def _backward(
    numbers, places, coefficients, cotangent, sums, to_coefficients, layers, rows, columns, bases, k2,
    BLOCK: tl.constexpr, PADDED: tl.constexpr,
):  # fmt: skip
    """Sum over the voxels of a Gaussian (gaussian, 10); also the gradient in its coefficients (gaussian, basis)."""
    g, basis = tl.program_id(0).to(tl.int64), tl.arange(0, PADDED)
    place = places + 9 * g
    first_row, first_column = tl.load(place + 5), tl.load(place + 7)
    width = tl.load(place + 8) - first_column
    area = (tl.load(place + 6) - first_row) * width
    weights = tl.load(coefficients + g * bases + basis, mask=basis < bases, other=0.0)
    zero = tl.zeros((BLOCK,), dtype=tl.float32)
    w, wx, wy, wz = zero, zero, zero, zero
    wxx, wxy, wxz, wyy, wyz, wzz = zero, zero, zero, zero, zero, zero
    to_weights = tl.zeros((BLOCK, PADDED), dtype=tl.float32)
    for layer in range(tl.load(place + 3), tl.load(place + 4)):
        for begin in range(0, area, BLOCK):
            voxel = begin + tl.arange(0, BLOCK)
            row, column = first_row + voxel // width, first_column + voxel % width
            value, x, y, z = value_in_voxels(numbers + 10 * g, place, column, row, layer, k2)
            value = tl.where(voxel < area, value, 0.0)
            at = ((basis[None].to(tl.int64) * layers + layer) * rows + row[:, None]) * columns + column[:, None]
            incoming = tl.load(cotangent + at, mask=(voxel < area)[:, None] & (basis < bases)[None], other=0.0)
            to_weights += incoming * value[:, None]
            to_value = tl.sum(incoming * weights[None], axis=1) * value
            w, wx, wy, wz = w + to_value, wx + to_value * x, wy + to_value * y, wz + to_value * z
            wxx, wxy, wxz = wxx + to_value * x * x, wxy + to_value * x * y, wxz + to_value * x * z
            wyy, wyz, wzz = wyy + to_value * y * y, wyz + to_value * y * z, wzz + to_value * z * z
    sums += 10 * g
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
    tl.store(to_coefficients + g * bases + basis, tl.sum(to_weights, 0), mask=basis < bases)


def forward(
    ellipsoids: Ellipsoids,
    coefficients: Float32[Tensor, "gaussian basis"],
    shape: tuple[int, int, int],
    cutoff: float,
) -> Float32[Tensor, "basis z y x"]:
    """Sum all Gaussians, times their coefficients.

    Parameters
    ----------
    ellipsoids : Gaussians on the grid
    coefficients : contiguous
    shape : of the grid (z, y, x)
    cutoff : where a Gaussian ends [standard deviations]

    Returns
    -------
    volume of each basis
    """
    bases = coefficients.shape[1]
    deep, down, across = (triton.cdiv(size, edge) for size, edge in zip(shape, _TILE, strict=True))
    out = coefficients.new_empty((bases, *shape))
    members, starts = tile_lists(ellipsoids.places[:, 3:].long(), _TILE, (deep, down, across))
    if deep * down * across and bases:
        _forward[(deep * down * across,)](
            *ellipsoids, coefficients, members, starts, out, *shape, down, across, bases, cutoff**2,
            *_TILE, triton.next_power_of_2(bases),
        )  # fmt: skip
    return out


def backward(
    ellipsoids: Ellipsoids,
    coefficients: Float32[Tensor, "gaussian basis"],
    cotangent: Float32[Tensor, "basis z y x"],
    cutoff: float,
) -> tuple[Float32[Tensor, "gaussian 10"], Float32[Tensor, "gaussian basis"]]:
    """Sum over the voxels of every Gaussian.

    Parameters
    ----------
    ellipsoids : Gaussians on the grid
    coefficients : contiguous
    cotangent : gradient in the volume; contiguous
    cutoff : where a Gaussian ends [standard deviations]

    Returns
    -------
    sums as in `recon.ops.voxelize.backward`, and the gradient in the coefficients
    """
    (n, bases), (_, layers, rows, columns) = coefficients.shape, cotangent.shape
    sums, to_coefficients = coefficients.new_empty((n, SUMS)), torch.empty_like(coefficients)
    if n and bases:
        _backward[(n,)](
            *ellipsoids, coefficients, cotangent, sums, to_coefficients, layers, rows, columns, bases, cutoff**2,
            _BLOCK, triton.next_power_of_2(bases),
        )  # fmt: skip
    return sums, to_coefficients
