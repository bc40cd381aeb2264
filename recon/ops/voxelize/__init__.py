"""Voxelize: Gaussians on a grid of voxels, each voxel holding its mean."""

import numpy as np
import torch
from jaxtyping import Float
from scipy.stats import chi2
from torch import Tensor

from phantomgen.geometry.voxel_grid import Grid
from recon.ops.arguments import GaussianTensors
from recon.ops.cpu_function import apply_on_cpu, on_gpu
from recon.ops.voxelize.cpu_calls import VoxelizeCall

CUTOFF = 4.5  # standard deviations; a Gaussian is below 4e-5 of its peak there


def voxelize(
    centres: Float[Tensor, "gaussian 3"],
    log_scales: Float[Tensor, "gaussian 3"],
    quaternions: Float[Tensor, "gaussian 4"],
    coefficients: Float[Tensor, "gaussian basis"],
    grid: Grid,
    footprint: float = 1.0,
    cutoff: float = CUTOFF,
) -> Float[np.ndarray, "basis z y x"]:
    """Compute the volume of each basis on a grid, each voxel holding the mean of the Gaussians in it.

    Gaussians on a GPU are voxelized there.

    Parameters
    ----------
    centres : centres of the Gaussians [mm]
    log_scales : logarithm of the standard deviations along the principal axes [log mm]
    quaternions : orientation (w, x, y, z); normalised here
    coefficients : value at the centre per basis [1/mm]
    grid : voxels to fill; any part of a grid gives the same values as the whole
    footprint : edge of the box that a voxel averages over [voxels]; 0 samples the voxel centre
    cutoff : where a Gaussian ends [standard deviations]

    Returns
    -------
    volumes [1/mm], float32
    """
    if on_gpu(centres):
        with torch.no_grad():
            volume = voxelize_tensor(centres, log_scales, quaternions, coefficients, grid, footprint, cutoff)
        return volume.float().cpu().numpy()
    gaussians = GaussianTensors(centres, log_scales, quaternions, coefficients)
    return VoxelizeCall(gaussians, grid, footprint, cutoff).values()


def mass_within(cutoff: float) -> float:
    """Compute the part of a Gaussian's mass within the cutoff, which a volume that is cut off there keeps.

    Parameters
    ----------
    cutoff : where a Gaussian ends [standard deviations]

    Returns
    -------
    part of the mass, 0 to 1
    """
    return float(chi2(3).cdf(cutoff**2))


def voxelize_tensor(
    centres: Float[Tensor, "gaussian 3"],
    log_scales: Float[Tensor, "gaussian 3"],
    quaternions: Float[Tensor, "gaussian 4"],
    coefficients: Float[Tensor, "gaussian basis"],
    grid: Grid,
    footprint: float = 1.0,
    cutoff: float = CUTOFF,
) -> Float[Tensor, "basis z y x"]:
    """Compute the volume of `voxelize` as a tensor, differentiable once in the first four arguments.

    Parameters
    ----------
    centres, log_scales, quaternions, coefficients, grid, footprint, cutoff : as in `voxelize`

    Returns
    -------
    volumes [1/mm], on the device and in the type of the coefficients
    """
    gaussians = GaussianTensors(centres, log_scales, quaternions, coefficients)
    if on_gpu(centres):
        from recon.ops.voxelize.gpu_calls import voxelize_on_gpu  # noqa: PLC0415 - Triton only where there is a GPU

        return voxelize_on_gpu(gaussians, grid, footprint, cutoff)
    return apply_on_cpu(lambda parts: VoxelizeCall(parts, grid, footprint, cutoff), gaussians)
