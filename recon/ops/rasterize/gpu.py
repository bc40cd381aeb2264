"""Triton kernels of the rasterizer: footprints to pixels of some views, and pixels back to footprints.

A program of `_forward` owns a tile of pixels and adds the Gaussians that its list names, in their order; a program of
`_backward` owns a Gaussian and sums over its pixels. Nothing is added atomically, so that results repeat bit by bit.
Numbers and sums of a footprint mean what they mean in `recon.ops.rasterize.cpu`. The tests run the kernels in Triton's
interpreter, and compile them for GPUs.
"""

from typing import no_type_check

import torch
import triton
import triton.language as tl
from jaxtyping import Float32, Int32, Int64
from torch import Tensor

from recon.ops.rasterize.footprint_table import Footprints
from recon.ops.tile_lists import tile_lists

NUMBERS = 11  # xc, yc, l11, l21, l22, e1 to e5, amplitude
SUMS = 12  # w, alpha (x, y, x^2, x y, y^2), beta (1, x, y, x^2, x y, y^2), as in `cpu.backward`
_TILE = 16  # edge of a tile
_BLOCK = 128  # pixels at a time of a Gaussian's program


@triton.jit
@no_type_check
def value_in_pixels(p, column, row, k2):
    """Compute the value of a footprint in pixels, their places (x, y) from its centre, 1 / E and N / E.

    Parameters
    ----------
    p : pointer to the numbers of the footprint
    column, row : the pixels
    k2 : square of the cutoff

    Returns
    -------
    value, x, y, 1 / E, which is 0 beyond the cutoff, and N / E
    """
    x, y = column.to(tl.float32) - tl.load(p), row.to(tl.float32) - tl.load(p + 1)
    flat = 1.0 + y * (tl.load(p + 6) + y * tl.load(p + 9))
    tilt = tl.load(p + 5) + tl.load(p + 8) * y
    inverse = 1.0 / ((x * tl.load(p + 7) + tilt) * x + flat)
    along, across = x * tl.load(p + 2) + y * tl.load(p + 3), y * tl.load(p + 4)
    q = (along * along + across * across) * inverse
    inside = (q >= 0.0) & (q < k2)
    value = tl.sqrt(tl.where(inside, inverse, 1.0)) * tl.exp(-0.5 * tl.where(inside, q, 0.0)) * tl.load(p + 10)
    return tl.where(inside, value, 0.0), x, y, tl.where(inside, inverse, 0.0), q


@triton.jit
@no_type_check
def _forward(
    numbers, coefficients, members, starts, out, count, rows, columns, down, across, bases, k2,
    TILE: tl.constexpr, PADDED: tl.constexpr,
):  # fmt: skip
    """Compute the pixels (view, basis, row, column) of a tile."""
    tile, pixel, basis = tl.program_id(0), tl.arange(0, TILE * TILE), tl.arange(0, PADDED)
    view, row = tile // (down * across), tile // across % down * TILE + pixel // TILE
    column = tile % across * TILE + pixel % TILE
    total = tl.zeros((TILE * TILE, PADDED), dtype=tl.float32)
    for k in range(tl.load(starts + tile), tl.load(starts + tile + 1)):
        seen = tl.load(members + k)
        value, _, _, _, _ = value_in_pixels(numbers + seen * 11, column, row, k2)
        weights = tl.load(coefficients + seen % count * bases + basis, mask=basis < bases, other=0.0)
        total += value[:, None] * weights[None]
    known = ((row < rows) & (column < columns))[:, None] & (basis < bases)[None]
    place = ((view * bases + basis[None]).to(tl.int64) * rows + row[:, None]) * columns + column[:, None]
    tl.store(out + place, total, mask=known)


@triton.jit
@no_type_check
def _backward(
    numbers, coefficients, bounds, cotangent, sums, to_coefficients, count, rows, columns, bases, k2,
    BLOCK: tl.constexpr, PADDED: tl.constexpr,
):  # fmt: skip
    """Sum over the pixels of a footprint (view, gaussian, 12); gradient in the coefficients (view, gaussian, basis)."""
    g, basis = tl.program_id(0).to(tl.int64), tl.arange(0, PADDED)
    view = g // count
    first_row, first_column = tl.load(bounds + 4 * g), tl.load(bounds + 4 * g + 2)
    width = tl.load(bounds + 4 * g + 3) - first_column
    pixels = (tl.load(bounds + 4 * g + 1) - first_row) * width
    weights = tl.load(coefficients + g % count * bases + basis, mask=basis < bases, other=0.0)
    zero = tl.zeros((BLOCK,), dtype=tl.float32)
    w, ax, ay, axx, axy, ayy = zero, zero, zero, zero, zero, zero
    b, bx, by, bxx, bxy, byy = zero, zero, zero, zero, zero, zero
    to_weights = tl.zeros((BLOCK, PADDED), dtype=tl.float32)
    for begin in range(0, pixels, BLOCK):
        pixel = begin + tl.arange(0, BLOCK)
        row, column = first_row + pixel // width, first_column + pixel % width
        value, x, y, inverse, q = value_in_pixels(numbers + g * 11, column, row, k2)
        value = tl.where(pixel < pixels, value, 0.0)
        place = ((view * bases + basis[None]).to(tl.int64) * rows + row[:, None]) * columns + column[:, None]
        known = (pixel < pixels)[:, None] & (basis < bases)[None]
        incoming = tl.load(cotangent + place, mask=known, other=0.0)
        to_weights += incoming * value[:, None]
        to_value = tl.sum(incoming * weights[None], axis=1) * value
        alpha = -0.5 * to_value * inverse
        beta = alpha - alpha * tl.where(value > 0.0, q, 0.0)
        w, ax, ay, b, bx, by = w + to_value, ax + alpha * x, ay + alpha * y, b + beta, bx + beta * x, by + beta * y
        axx, axy, ayy = axx + alpha * x * x, axy + alpha * x * y, ayy + alpha * y * y
        bxx, bxy, byy = bxx + beta * x * x, bxy + beta * x * y, byy + beta * y * y
    sums += 12 * g
    tl.store(sums, tl.sum(w, 0))
    tl.store(sums + 1, tl.sum(ax, 0))
    tl.store(sums + 2, tl.sum(ay, 0))
    tl.store(sums + 3, tl.sum(axx, 0))
    tl.store(sums + 4, tl.sum(axy, 0))
    tl.store(sums + 5, tl.sum(ayy, 0))
    tl.store(sums + 6, tl.sum(b, 0))
    tl.store(sums + 7, tl.sum(bx, 0))
    tl.store(sums + 8, tl.sum(by, 0))
    tl.store(sums + 9, tl.sum(bxx, 0))
    tl.store(sums + 10, tl.sum(bxy, 0))
    tl.store(sums + 11, tl.sum(byy, 0))
    tl.store(to_coefficients + g * bases + basis, tl.sum(to_weights, 0), mask=basis < bases)


def pixel_tiles(
    bounds: Int32[Tensor, "view gaussian 4"], panel: tuple[int, int]
) -> tuple[int, int, Int64[Tensor, " member"], Int64[Tensor, " tile_plus_1"]]:
    """List the footprints of each tile of pixels of each view.

    Parameters
    ----------
    bounds : first row, one past the last, first column, one past the last
    panel : rows and columns

    Returns
    -------
    tiles of a view down and across; numbers of the footprints, and where the list of each tile starts
    """
    views, n, _ = bounds.shape
    down, across = (triton.cdiv(size, _TILE) for size in panel)
    view = torch.arange(views, device=bounds.device)[:, None, None].expand(views, n, 1)
    boxes = torch.cat([view, view + 1, bounds.long()], -1).reshape(views * n, 6)
    return down, across, *tile_lists(boxes, (1, _TILE, _TILE), (views, down, across))


def forward(
    footprints: Footprints, coefficients: Float32[Tensor, "gaussian basis"], panel: tuple[int, int], cutoff: float
) -> Float32[Tensor, "view basis row column"]:
    """Sum all footprints, times their coefficients.

    Parameters
    ----------
    footprints : of all Gaussians in some views
    coefficients : contiguous
    panel : rows and columns
    cutoff : where a footprint ends [standard deviations]

    Returns
    -------
    images of each basis, without |d|
    """
    (n, bases), views = coefficients.shape, len(footprints.numbers)
    out = coefficients.new_empty((views, bases, *panel))
    down, across, members, starts = pixel_tiles(footprints.bounds, panel)
    if out.numel():
        _forward[(views * down * across,)](
            footprints.numbers, coefficients, members, starts, out, n, *panel, down, across, bases, cutoff**2,
            _TILE, triton.next_power_of_2(bases),
        )  # fmt: skip
    return out


def backward(
    footprints: Footprints,
    coefficients: Float32[Tensor, "gaussian basis"],
    cotangent: Float32[Tensor, "view basis row column"],
    cutoff: float,
) -> tuple[Float32[Tensor, "view gaussian 12"], Float32[Tensor, "view gaussian basis"]]:
    """Sum over the pixels of every footprint.

    Parameters
    ----------
    footprints : of all Gaussians in some views
    coefficients : contiguous
    cotangent : gradient in the images, times |d|; contiguous
    cutoff : where a footprint ends [standard deviations]

    Returns
    -------
    sums as in `recon.ops.rasterize.cpu.backward`, and the gradient in the coefficients, of each view
    """
    (n, bases), (views, _, rows, columns) = coefficients.shape, cotangent.shape
    sums, to_coefficients = coefficients.new_empty((views, n, SUMS)), coefficients.new_empty((views, n, bases))
    if to_coefficients.numel():
        _backward[(views * n,)](
            footprints.numbers, coefficients, footprints.bounds, cotangent, sums, to_coefficients,
            n, rows, columns, bases, cutoff**2, _BLOCK, triton.next_power_of_2(bases),
        )  # fmt: skip
    return sums, to_coefficients
