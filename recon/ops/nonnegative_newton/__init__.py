"""Steps of voxels in the metric of their curvature that end at non-negative coefficients."""

import numpy as np
from jaxtyping import Float

from recon.ops.nonnegative_newton import cpu
from spectra.threads import run_parallel

CHUNK = 8192  # voxels per piece of work

Volumes = Float[np.ndarray, "basis *voxels"]
Blocks = Float[np.ndarray, "pair *voxels"]


def nonnegative_newton_step(volumes: Volumes, inverse: Blocks, cotangents: Volumes, bounded: bool = True) -> Volumes:
    """The non-negative x nearest to ``volumes - inverse cotangents``, in the metric whose inverse is given.

    That is the minimum of ``<cotangents, x> + (x - volumes)^T inverse^-1 (x - volumes) / 2`` over x >= 0, voxel by
    voxel.

    Parameters
    ----------
    volumes, cotangents : where to begin, and the gradient there
    inverse : inverse of each voxel's positive definite block, upper triangle row by row
    bounded : whether x >= 0 is asked for
    """
    bases, *shape = volumes.shape
    begin, blocks, slopes = (
        np.ascontiguousarray(a, np.float32).reshape(len(a), -1) for a in (volumes, inverse, cotangents)
    )
    out = np.empty_like(begin)

    def chunk(first: int) -> None:
        room = np.empty((2 * bases + 4, bases))
        cpu.nonnegative_newton_step(begin, blocks, slopes, bounded, first, min(first + CHUNK, out.shape[1]), room, out)

    for _ in run_parallel(chunk, range(0, out.shape[1], CHUNK)):
        pass
    return out.reshape(bases, *shape)


def inverse_blocks(blocks: Blocks, floor: Float[np.ndarray, " basis"]) -> Blocks:
    """Inverse of each voxel's block, with `floor` added to the diagonal; both as upper triangles, row by row."""
    pairs, *shape = blocks.shape
    flat = np.ascontiguousarray(blocks, np.float32).reshape(pairs, -1)
    out = np.empty_like(flat)
    added = np.asarray(floor, dtype=np.float64)

    def chunk(first: int) -> None:
        room = np.empty((2, len(added), len(added)))
        cpu.inverse_blocks(flat, added, first, min(first + CHUNK, out.shape[1]), room, out)

    for _ in run_parallel(chunk, range(0, out.shape[1], CHUNK)):
        pass
    return out.reshape(pairs, *shape)


def as_matrices(blocks: Float[np.ndarray, "pair ..."]) -> Float[np.ndarray, "... basis basis"]:
    """Upper triangles, row by row, as whole symmetric matrices."""
    bases = int(np.sqrt(2 * len(blocks)))
    upper = np.triu_indices(bases)
    out = np.empty((*blocks.shape[1:], bases, bases), blocks.dtype)
    for values, m, n in zip(blocks, *upper, strict=True):
        out[..., m, n] = out[..., n, m] = values
    return out
