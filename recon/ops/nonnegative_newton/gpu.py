"""Non-negative Newton steps of up to three bases in Triton: the steps of `cpu._pivot_three`, in float64."""

from typing import no_type_check

import torch
import triton
import triton.language as tl
from jaxtyping import Float32
from torch import Tensor

MOST_BASES = 3
_BLOCK = 256  # voxels per program


@triton.jit
@no_type_check
def _load(values, row, voxel, voxels, known, wanted: tl.constexpr, other: tl.constexpr):
    """Load a row of voxels in float64; a constant where there is no such row."""
    if wanted:
        found = tl.load(values + row * voxels + voxel, mask=known, other=0.0).to(tl.float64)
    else:
        found = tl.full(voxel.shape, other, tl.float64)
    return found


@triton.jit
@no_type_check
def _forces(a, b, c, d, e, f, u, v, w):
    """Solve a symmetric 3 x 3 system by Cramer's rule."""
    p, q, r = d * f - e * e, c * e - b * f, b * e - c * d
    s, t, o = a * f - c * c, b * c - a * e, a * d - b * b
    scale = 1.0 / (a * p + b * q + c * r)
    return scale * (p * u + q * v + r * w), scale * (q * u + s * v + t * w), scale * (r * u + t * v + o * w)


@triton.jit
@no_type_check
def _step(volumes, inverse, cotangents, out, voxels, BOUNDED: tl.constexpr, BASES: tl.constexpr, BLOCK: tl.constexpr):
    """Nearest non-negative points of a block of voxels; bases that pad them to three are 1 and not coupled."""
    voxel = tl.program_id(0).to(tl.int64) * BLOCK + tl.arange(0, BLOCK)
    known = voxel < voxels
    two, three = BASES > 1, BASES > 2
    a = _load(inverse, 0, voxel, voxels, known, True, 1.0)
    b = _load(inverse, 1, voxel, voxels, known, two, 0.0)
    c = _load(inverse, 2, voxel, voxels, known, three, 0.0)
    d = _load(inverse, 3 if three else 2, voxel, voxels, known, two, 1.0)
    e = _load(inverse, 4, voxel, voxels, known, three, 0.0)
    f = _load(inverse, 5, voxel, voxels, known, three, 1.0)
    one = tl.full(voxel.shape, 1.0, tl.float64)
    a, d, f = tl.where(known, a, one), tl.where(known, d, one), tl.where(known, f, one)
    x, y, z = (
        _load(cotangents, 0, voxel, voxels, known, True, 0.0),
        _load(cotangents, 1, voxel, voxels, known, two, 0.0),
        _load(cotangents, 2, voxel, voxels, known, three, 0.0),
    )
    u = _load(volumes, 0, voxel, voxels, known, True, 1.0) - a * x - b * y - c * z
    v = _load(volumes, 1, voxel, voxels, known, two, 1.0) - b * x - d * y - e * z
    w = _load(volumes, 2, voxel, voxels, known, three, 1.0) - c * x - e * y - f * z
    x, y, z = u, v, w
    if BOUNDED:
        i, j, k = u < 0.0, v < 0.0, w < 0.0
        for _ in tl.static_range(3):
            p, q, r = _forces(
                tl.where(i, a, 1.0), tl.where(i & j, b, 0.0), tl.where(i & k, c, 0.0), tl.where(j, d, 1.0),
                tl.where(j & k, e, 0.0), tl.where(k, f, 1.0),
                tl.where(i, u, 0.0), tl.where(j, v, 0.0), tl.where(k, w, 0.0),
            )  # fmt: skip
            x, y, z = u - a * p - b * q - c * r, v - b * p - d * q - e * r, w - c * p - e * q - f * r
            free_x, free_y, free_z = tl.where(i, 0.0, x), tl.where(j, 0.0, y), tl.where(k, 0.0, z)
            i, j, k = tl.where(i, p, x) < 0.0, tl.where(j, q, y) < 0.0, tl.where(k, r, z) < 0.0
            x, y, z = free_x, free_y, free_z
        x, y, z = tl.maximum(x, 0.0), tl.maximum(y, 0.0), tl.maximum(z, 0.0)
    tl.store(out + voxel, x.to(tl.float32), mask=known)
    if two:
        tl.store(out + voxels + voxel, y.to(tl.float32), mask=known)
    if three:
        tl.store(out + 2 * voxels + voxel, z.to(tl.float32), mask=known)


def nonnegative_newton_step(
    volumes: Float32[Tensor, "basis voxel"],
    inverse: Float32[Tensor, "pair voxel"],
    cotangents: Float32[Tensor, "basis voxel"],
    bounded: bool,
) -> Float32[Tensor, "basis voxel"]:
    """Compute the steps of `recon.ops.nonnegative_newton.nonnegative_newton_step`.

    Parameters
    ----------
    volumes, inverse, cotangents : contiguous, of at most `MOST_BASES` bases
    bounded : whether x >= 0 is required

    Returns
    -------
    x
    """
    (bases, voxels), out = volumes.shape, torch.empty_like(volumes)
    if voxels:
        _step[(triton.cdiv(voxels, _BLOCK),)](
            volumes, inverse, cotangents, out, voxels, bounded, bases, _BLOCK
        )  # fmt: skip
    return out
