"""Voxelize: Gaussians on a grid of voxels, each voxel holding its mean."""

import numpy as np
from jaxtyping import Float
from torch import Tensor

from phantomgen.grid import Grid
from recon.ops.rasterize.cpu import whitening
from recon.ops.simd import WIDTH
from recon.ops.voxelize import cpu
from spectra.threads import run_parallel

CUTOFF = 4.5  # standard deviations; a Gaussian is below 4e-5 of its peak there
SLAB = 4  # slices per piece of work


def voxelize(
    centres: Float[Tensor, "gaussian 3"],
    log_scales: Float[Tensor, "gaussian 3"],
    quaternions: Float[Tensor, "gaussian 4"],
    coefficients: Float[Tensor, "gaussian basis"],
    grid: Grid,
    footprint: float = 1.0,
    cutoff: float = CUTOFF,
) -> Float[np.ndarray, "basis z y x"]:
    """Volume of each basis [1/mm] on `grid`, float32.

    Parameters
    ----------
    centres : centres of the Gaussians [mm]
    log_scales : logarithm of the standard deviations along the principal axes [log mm]
    quaternions : orientation (w, x, y, z)
    coefficients : value at the centre per basis [1/mm]
    grid : where to evaluate; any part of a grid gives the same values as the whole
    footprint : edge of the box a voxel averages over, in voxels; 0 samples the voxel centre
    cutoff : where a Gaussian ends, in standard deviations
    """
    arrays = (x.detach().cpu().numpy().astype(np.float64) for x in (centres, log_scales, quaternions))
    centres_, log_scales_, quaternions_ = arrays
    weights = coefficients.detach().cpu().numpy().astype(np.float32)
    n, bases = weights.shape
    matrices, table = np.empty((n, 3, 3)), np.empty((n, cpu.SHAPE_SIZE), np.float32)
    whitening(log_scales_, quaternions_, 0, n, matrices)
    origin, spacing = np.array(grid.origin[::-1], float), np.array(grid.spacing[::-1], float)
    cpu.shapes(centres_, matrices, origin, spacing, footprint**2 / 12, cutoff, 0, n, table)

    slices, rows, columns = grid.shape
    volume = np.zeros((bases, slices, rows, columns + WIDTH), np.float32)

    def fill(first: int) -> None:
        cpu.fill(table, weights, cutoff, columns, first, min(first + SLAB, slices), volume)

    for _ in run_parallel(fill, range(0, slices, SLAB)):
        pass
    return np.ascontiguousarray(volume[..., :columns])
