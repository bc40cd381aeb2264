"""The two steps of the total variation in Triton, with the meaning of `recon.ops.total_variation.cpu`.

A program owns a block of voxels and gathers, so nothing is added atomically and results repeat bit by bit.
"""

from typing import no_type_check

import numpy as np
import triton
import triton.language as tl
from jaxtyping import Float, Float32
from torch import Tensor

_BLOCK = 256  # voxels per program


@triton.jit
@no_type_check
def _places(voxels, height, width, BLOCK: tl.constexpr):
    """Voxels of a program, which exist, and their places along z, y and x."""
    voxel = tl.program_id(0).to(tl.int64) * BLOCK + tl.arange(0, BLOCK)
    return voxel, voxel < voxels, voxel // (height * width), voxel // width % height, voxel % width


@triton.jit
@no_type_check
def _ascend(
    field, volumes, mixing, steps, radii, scale_z, scale_y, scale_x, voxels, depth, height, width,
    BASES: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Move the field of a block of voxels by W D x, and project it onto balls."""
    voxel, known, z, y, x = _places(voxels, height, width, BLOCK)
    step = tl.load(steps + voxel, mask=known, other=0.0)
    radius = tl.load(radii + voxel, mask=known, other=0.0)
    squares = tl.zeros((BLOCK,), dtype=tl.float32)
    for axis in tl.static_range(3):
        stride = height * width if axis == 0 else (width if axis == 1 else 1)
        scale = scale_z if axis == 0 else (scale_y if axis == 1 else scale_x)
        inner = z + 1 < depth if axis == 0 else (y + 1 < height if axis == 1 else x + 1 < width)
        for m in tl.static_range(BASES):
            mixed = tl.zeros((BLOCK,), dtype=tl.float32)
            for n in tl.static_range(BASES):
                here = volumes + n * voxels + voxel
                after = tl.load(here + stride, mask=known & inner, other=0.0)
                difference = tl.where(inner, after - tl.load(here, mask=known, other=0.0), 0.0)
                mixed += tl.load(mixing + m * BASES + n) * (scale * difference)
            place = field + (axis * BASES + m) * voxels + voxel
            moved = tl.load(place, mask=known, other=0.0) + step * mixed
            squares += moved * moved
            tl.store(place, moved, mask=known)
    length = tl.maximum(radius, tl.sqrt(squares))
    factor = tl.where(radius > 0.0, radius / tl.where(length > 0.0, length, 1.0), 0.0)
    for k in tl.static_range(3 * BASES):
        place = field + k * voxels + voxel
        tl.store(place, factor * tl.load(place, mask=known, other=0.0), mask=known)


@triton.jit
@no_type_check
def _gradient(
    field, mixing, out, scale_z, scale_y, scale_x, voxels, depth, height, width,
    BASES: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """D^T W^T p of a block of voxels."""
    voxel, known, z, y, x = _places(voxels, height, width, BLOCK)
    for m in tl.static_range(BASES):
        total = tl.zeros((BLOCK,), dtype=tl.float32)
        for n in tl.static_range(BASES):
            row = tl.zeros((BLOCK,), dtype=tl.float32)
            for axis in tl.static_range(3):
                stride = height * width if axis == 0 else (width if axis == 1 else 1)
                scale = scale_z if axis == 0 else (scale_y if axis == 1 else scale_x)
                place = z if axis == 0 else (y if axis == 1 else x)
                size = depth if axis == 0 else (height if axis == 1 else width)
                entry = field + (axis * BASES + n) * voxels + voxel
                row += scale * tl.load(entry - stride, mask=known & (place > 0), other=0.0)
                row -= scale * tl.load(entry, mask=known & (place + 1 < size), other=0.0)
            total += tl.load(mixing + n * BASES + m) * row
        tl.store(out + m * voxels + voxel, total, mask=known)


def ascend(
    field: Float32[Tensor, "axis basis z y x"],
    volumes: Float32[Tensor, "basis z y x"],
    mixing: Float[np.ndarray, "basis basis"],
    scales: Float[np.ndarray, "3"],
    steps: Float32[Tensor, "z y x"],
    radii: Float32[Tensor, "z y x"],
) -> None:
    """Move a field, in place, by `steps` times W D x, and project it onto the ball of each voxel's radius around 0.

    Parameters
    ----------
    field : p of every voxel, contiguous
    volumes : x, contiguous
    mixing : W
    scales : factors of the differences along z, y and x
    steps, radii : of each voxel, contiguous
    """
    bases, depth, height, width = volumes.shape
    voxels = depth * height * width
    if voxels:
        factors = volumes.new_tensor(np.ascontiguousarray(mixing, np.float32))
        along_z, along_y, along_x = map(float, scales)
        _ascend[(triton.cdiv(voxels, _BLOCK),)](
            field, volumes, factors, steps, radii, along_z, along_y, along_x,
            voxels, depth, height, width, bases, _BLOCK,
        )  # fmt: skip


def gradient(
    field: Float32[Tensor, "axis basis z y x"], mixing: Float[np.ndarray, "basis basis"], scales: Float[np.ndarray, "3"]
) -> Float32[Tensor, "basis z y x"]:
    """Compute D^T W^T p.

    Parameters
    ----------
    field : p of every voxel, contiguous
    mixing : W
    scales : factors of the differences along z, y and x

    Returns
    -------
    volumes
    """
    _, bases, depth, height, width = field.shape
    voxels, out = depth * height * width, field.new_empty(field.shape[1:])
    if voxels:
        factors = field.new_tensor(np.ascontiguousarray(mixing, np.float32))
        along_z, along_y, along_x = map(float, scales)
        _gradient[(triton.cdiv(voxels, _BLOCK),)](
            field, factors, out, along_z, along_y, along_x, voxels, depth, height, width, bases, _BLOCK
        )
    return out
