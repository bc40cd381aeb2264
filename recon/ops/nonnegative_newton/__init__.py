"""Newton steps of voxels, in the metric of their curvature, that end at non-negative coefficients."""

from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from recon.ops.nonnegative_newton import cpu
from recon.ops.pieces import run_in_pieces

CHUNK = 8192  # voxels per piece of work

Array = Any  # an array, or a tensor on a GPU
Blocks = Float[np.ndarray, "pair *voxels"]


def nonnegative_newton_step(
    volumes: Float[Array, "basis *voxels"],
    inverse: Float[Array, "pair *voxels"],
    cotangents: Float[Array, "basis *voxels"],
    bounded: bool = True,
) -> Float[Array, "basis *voxels"]:
    """Find the non-negative x nearest to ``volumes - inverse cotangents``, in the metric whose inverse is given.

    It is the minimum of ``<cotangents, x> + (x - volumes)^T inverse^-1 (x - volumes) / 2`` over x >= 0, voxel by
    voxel.

    Parameters
    ----------
    volumes : start; arrays, or tensors on a GPU, where more than three bases are computed by the processor
    inverse : inverse of each voxel's positive definite block, upper triangle row by row
    cotangents : gradient at the start
    bounded : whether x >= 0 is required

    Returns
    -------
    x, float32
    """
    if isinstance(volumes, Tensor):
        return _step_of_tensors(volumes, inverse, cotangents, bounded)
    bases, *shape = volumes.shape
    begin, blocks, slopes = (
        np.ascontiguousarray(a, np.float32).reshape(len(a), -1) for a in (volumes, inverse, cotangents)
    )
    out = np.empty_like(begin)

    def chunk(first: int, last: int) -> None:
        room = np.empty((2 * bases + 4, bases))
        cpu.nonnegative_newton_step(begin, blocks, slopes, bounded, first, last, room, out)

    run_in_pieces(chunk, out.shape[1], CHUNK)
    return out.reshape(bases, *shape)


def _step_of_tensors(volumes: Tensor, inverse: Tensor, cotangents: Tensor, bounded: bool) -> Tensor:
    """Compute the step of tensors: by Triton, or by the processor where there are many bases."""
    from recon.ops.nonnegative_newton import gpu  # noqa: PLC0415 - Triton only where there is a GPU

    if len(volumes) > gpu.MOST_BASES:
        start, blocks, slopes = (part.cpu().numpy() for part in (volumes, inverse, cotangents))
        return torch.from_numpy(nonnegative_newton_step(start, blocks, slopes, bounded)).to(volumes)
    begin, metric, slope = (part.float().flatten(1).contiguous() for part in (volumes, inverse, cotangents))
    return gpu.nonnegative_newton_step(begin, metric, slope, bounded).reshape(volumes.shape)


def inverse_blocks(blocks: Blocks, floor: Float[np.ndarray, " basis"]) -> Blocks:
    """Invert the block of each voxel.

    Parameters
    ----------
    blocks : upper triangles, row by row
    floor : added to the diagonal of all blocks

    Returns
    -------
    upper triangles of the inverses, row by row, float32
    """
    pairs, *shape = blocks.shape
    flat = np.ascontiguousarray(blocks, np.float32).reshape(pairs, -1)
    out = np.empty_like(flat)
    added = np.asarray(floor, dtype=np.float64)

    def chunk(first: int, last: int) -> None:
        room = np.empty((2, len(added), len(added)))
        cpu.inverse_blocks(flat, added, first, last, room, out)

    run_in_pieces(chunk, out.shape[1], CHUNK)
    return out.reshape(pairs, *shape)


def as_matrices(blocks: Float[np.ndarray, "pair ..."]) -> Float[np.ndarray, "... basis basis"]:
    """Expand upper triangles to symmetric matrices.

    Parameters
    ----------
    blocks : upper triangles, row by row

    Returns
    -------
    whole matrices
    """
    bases = int(np.sqrt(2 * len(blocks)))
    upper = np.triu_indices(bases)
    out = np.empty((*blocks.shape[1:], bases, bases), blocks.dtype)
    for values, m, n in zip(blocks, *upper, strict=True):
        out[..., m, n] = out[..., n, m] = values
    return out
