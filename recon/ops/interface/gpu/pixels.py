"""Triton kernels: images of divided Gaussians from their footprints, and sums over pixels for the gradients.

Numbers and sums mean what they mean in `recon.ops.interface.table` and `recon.ops.interface.cpu`. A program of
`_forward` owns a tile of pixels of a view and adds the Gaussians that its list names, in their order; a program of
`_backward` owns a Gaussian in a view and sums over its pixels. Nothing is added atomically, so that results repeat bit
by bit. The tests run the kernels in Triton's interpreter, and compile them for GPUs.
"""

from typing import NamedTuple, no_type_check

import triton
import triton.language as tl
from jaxtyping import Float32
from torch import Tensor

from recon.ops.interface.table import SUMS
from recon.ops.rasterize.footprint_table import Footprints
from recon.ops.rasterize.gpu import pixel_tiles, value_in_pixels

_TILE = 16  # edge of a tile
_BLOCK = 128  # pixels at a time of a Gaussian's program


class DeviceSides(NamedTuple):
    """Coefficients of both sides on the device, contiguous.

    Parameters
    ----------
    below : below the planes [1/mm]
    step : above the planes less those below [1/mm]
    """

    below: Float32[Tensor, "gaussian basis"]
    step: Float32[Tensor, "gaussian basis"]


@triton.jit
@no_type_check
def part_above(z):
    """Compute the normal distribution function and density.

    Parameters
    ----------
    z : places [standard deviations]

    Returns
    -------
    function and density
    """
    return 0.5 + 0.5 * tl.math.erf(z * 0.7071067811865476), 0.3989422804014327 * tl.exp(-0.5 * z * z)


@triton.jit
@no_type_check
def _plane(p, x, y, inverse):
    """Compute E, the numerator of z, B, and WIDTH E + B^2, in pixels x, y from the centre; E is 1 beyond the cutoff."""
    e = 1.0 / tl.where(inverse > 0.0, inverse, 1.0)
    level, rise = y * (tl.load(p + 13) + y * tl.load(p + 16)), tl.load(p + 12) + tl.load(p + 15) * y
    above = (x * tl.load(p + 14) + rise) * x + level - e * tl.load(p + 11)
    b = x * tl.load(p + 18) + tl.load(p + 17) + tl.load(p + 19) * y
    return e, above, b, e * tl.load(p + 20) + b * b


@triton.jit
@no_type_check
def _forward(
    numbers, below, step, members, starts, out, count, rows, columns, down, across, bases, k2,
    TILE: tl.constexpr, PADDED: tl.constexpr,
):  # fmt: skip
    """Compute the pixels (view, basis, row, column) of a tile."""
    tile, pixel, basis = tl.program_id(0), tl.arange(0, TILE * TILE), tl.arange(0, PADDED)
    view, row = tile // (down * across), tile // across % down * TILE + pixel // TILE
    column = tile % across * TILE + pixel % TILE
    total = tl.zeros((TILE * TILE, PADDED), dtype=tl.float32)
    for k in range(tl.load(starts + tile), tl.load(starts + tile + 1)):
        seen = tl.load(members + k)
        p, g = numbers + seen * 21, seen % count * bases + basis
        value, x, y, inverse, _ = value_in_pixels(p, column, row, k2)
        _, above, _, under = _plane(p, x, y, inverse)
        part, _ = part_above(above * tl.sqrt(inverse / under))
        low = tl.load(below + g, mask=basis < bases, other=0.0)
        more = tl.load(step + g, mask=basis < bases, other=0.0)
        total += value[:, None] * low[None] + (value * part)[:, None] * more[None]
    known = ((row < rows) & (column < columns))[:, None] & (basis < bases)[None]
    place = ((view * bases + basis[None]).to(tl.int64) * rows + row[:, None]) * columns + column[:, None]
    tl.store(out + place, total, mask=known)


@triton.jit
@no_type_check
def _backward(
    numbers, below, step, bounds, cotangent, sums, to_below, to_step, count, rows, columns, bases, k2,
    BLOCK: tl.constexpr, PADDED: tl.constexpr,
):  # fmt: skip
    """Sum over the pixels of a footprint (view, gaussian, 23); gradients in both sides (view, gaussian, basis)."""
    seen, basis = tl.program_id(0).to(tl.int64), tl.arange(0, PADDED)
    view, p = seen // count, numbers + seen * 21
    first_row, first_column = tl.load(bounds + 4 * seen), tl.load(bounds + 4 * seen + 2)
    width = tl.load(bounds + 4 * seen + 3) - first_column
    pixels = (tl.load(bounds + 4 * seen + 1) - first_row) * width
    low = tl.load(below + seen % count * bases + basis, mask=basis < bases, other=0.0)
    more = tl.load(step + seen % count * bases + basis, mask=basis < bases, other=0.0)
    zero = tl.zeros((BLOCK,), dtype=tl.float32)
    w, ax, ay, axx, axy, ayy = zero, zero, zero, zero, zero, zero
    e0, ex, ey, exx, exy, eyy = zero, zero, zero, zero, zero, zero
    q0, qx, qy, qxx, qxy, qyy = zero, zero, zero, zero, zero, zero
    b0, bx, by, to_offset, to_width = zero, zero, zero, zero, zero
    to_low = tl.zeros((BLOCK, PADDED), dtype=tl.float32)
    to_more = tl.zeros((BLOCK, PADDED), dtype=tl.float32)
    for begin in range(0, pixels, BLOCK):
        pixel = begin + tl.arange(0, BLOCK)
        row, column = first_row + pixel // width, first_column + pixel % width
        value, x, y, inverse, q = value_in_pixels(p, column, row, k2)
        value, q = tl.where(pixel < pixels, value, 0.0), tl.where(inverse > 0.0, q, 0.0)
        e, above, b, under = _plane(p, x, y, inverse)
        scale = tl.sqrt(inverse / under)
        z = above * scale
        part, density = part_above(z)
        place = ((view * bases + basis[None]).to(tl.int64) * rows + row[:, None]) * columns + column[:, None]
        known = (pixel < pixels)[:, None] & (basis < bases)[None]
        incoming = tl.load(cotangent + place, mask=known, other=0.0)
        to_low += incoming * value[:, None]
        to_more += incoming * (part * value)[:, None]
        to_part = tl.sum(incoming * more[None], axis=1)
        to_value = (tl.sum(incoming * low[None], axis=1) + to_part * part) * value
        to_z = to_part * value * density
        alpha = -0.5 * to_value * inverse
        to_above, half = to_z * scale, -0.5 * to_z * z
        to_e = alpha - alpha * q - to_above * tl.load(p + 11) + half * (inverse + tl.load(p + 20) / under)
        to_b = 2.0 * half * b / under
        w, to_offset, to_width = w + to_value, to_offset - to_above * e, to_width + half * e / under
        ax, ay, axx, axy, ayy = (
            ax + alpha * x, ay + alpha * y, axx + alpha * x * x, axy + alpha * x * y, ayy + alpha * y * y
        )  # fmt: skip
        e0, ex, ey = e0 + to_e, ex + to_e * x, ey + to_e * y
        exx, exy, eyy = exx + to_e * x * x, exy + to_e * x * y, eyy + to_e * y * y
        q0, qx, qy = q0 + to_above, qx + to_above * x, qy + to_above * y
        qxx, qxy, qyy = qxx + to_above * x * x, qxy + to_above * x * y, qyy + to_above * y * y
        b0, bx, by = b0 + to_b, bx + to_b * x, by + to_b * y
    sums += 23 * seen
    tl.store(sums, tl.sum(w, 0))
    tl.store(sums + 1, tl.sum(ax, 0))
    tl.store(sums + 2, tl.sum(ay, 0))
    tl.store(sums + 3, tl.sum(axx, 0))
    tl.store(sums + 4, tl.sum(axy, 0))
    tl.store(sums + 5, tl.sum(ayy, 0))
    tl.store(sums + 6, tl.sum(e0, 0))
    tl.store(sums + 7, tl.sum(ex, 0))
    tl.store(sums + 8, tl.sum(ey, 0))
    tl.store(sums + 9, tl.sum(exx, 0))
    tl.store(sums + 10, tl.sum(exy, 0))
    tl.store(sums + 11, tl.sum(eyy, 0))
    tl.store(sums + 12, tl.sum(to_offset, 0))
    tl.store(sums + 13, tl.sum(q0, 0))
    tl.store(sums + 14, tl.sum(qx, 0))
    tl.store(sums + 15, tl.sum(qy, 0))
    tl.store(sums + 16, tl.sum(qxx, 0))
    tl.store(sums + 17, tl.sum(qxy, 0))
    tl.store(sums + 18, tl.sum(qyy, 0))
    tl.store(sums + 19, tl.sum(b0, 0))
    tl.store(sums + 20, tl.sum(bx, 0))
    tl.store(sums + 21, tl.sum(by, 0))
    tl.store(sums + 22, tl.sum(to_width, 0))
    tl.store(to_below + seen * bases + basis, tl.sum(to_low, 0), mask=basis < bases)
    tl.store(to_step + seen * bases + basis, tl.sum(to_more, 0), mask=basis < bases)


def forward(
    footprints: Footprints, sides: DeviceSides, panel: tuple[int, int], cutoff: float
) -> Float32[Tensor, "view basis row column"]:
    """Sum all footprints, times the coefficients of their sides.

    Parameters
    ----------
    footprints : of all Gaussians in some views
    sides : coefficients
    panel : rows and columns
    cutoff : where a footprint ends [standard deviations]

    Returns
    -------
    images of each basis, without |d|
    """
    (n, bases), views = sides.below.shape, len(footprints.numbers)
    out = sides.below.new_empty((views, bases, *panel))
    down, across, members, starts = pixel_tiles(footprints.bounds, panel)
    if out.numel():
        _forward[(views * down * across,)](
            footprints.numbers, *sides, members, starts, out, n, *panel, down, across, bases, cutoff**2,
            _TILE, triton.next_power_of_2(bases),
        )  # fmt: skip
    return out


def backward(
    footprints: Footprints, sides: DeviceSides, cotangent: Float32[Tensor, "view basis row column"], cutoff: float
) -> tuple[
    Float32[Tensor, "view gaussian 23"], Float32[Tensor, "view gaussian basis"], Float32[Tensor, "view gaussian basis"]
]:
    """Sum over the pixels of every footprint.

    Parameters
    ----------
    footprints : of all Gaussians in some views
    sides : coefficients
    cotangent : gradient in the images, times |d|; contiguous
    cutoff : where a footprint ends [standard deviations]

    Returns
    -------
    sums as in `recon.ops.interface.cpu.backward`, and the gradients below and in the step, of each view
    """
    (n, bases), (views, _, rows, columns) = sides.below.shape, cotangent.shape
    sums = sides.below.new_empty((views, n, SUMS))
    to_below, to_step = (sides.below.new_empty((views, n, bases)) for _ in sides)
    if to_below.numel():
        _backward[(views * n,)](
            footprints.numbers, *sides, footprints.bounds, cotangent, sums, to_below, to_step,
            n, rows, columns, bases, cutoff**2, _BLOCK, triton.next_power_of_2(bases),
        )  # fmt: skip
    return sums, to_below, to_step
