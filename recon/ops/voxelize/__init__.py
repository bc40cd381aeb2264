"""Voxelize: Gaussians on a grid of voxels, each voxel holding its mean."""

from importlib.util import find_spec

import numpy as np
import torch
from jaxtyping import Float
from scipy.stats import chi2
from torch import Tensor

from phantomgen.geometry.voxel_grid import Grid
from recon.ops.voxelize.cpu_calls import Scene

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

    Gaussians on a GPU are voxelized there.
    """
    if _on_gpu(centres):
        with torch.no_grad():
            volume = voxelize_tensor(centres, log_scales, quaternions, coefficients, grid, footprint, cutoff)
        return volume.float().cpu().numpy()
    return Scene(centres, log_scales, quaternions, coefficients, grid, footprint, cutoff).volume()


def mass_within(cutoff: float) -> float:
    """Part of a Gaussian's mass within so many standard deviations, which is what a volume cut off there keeps."""
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
    """`voxelize` as a tensor on the device of the Gaussians, differentiable once in the first four arguments."""
    if _on_gpu(centres):
        from recon.ops.voxelize.gpu_calls import voxelize_on_gpu  # noqa: PLC0415 - Triton only where there is a GPU

        return voxelize_on_gpu(centres, log_scales, quaternions, coefficients, grid, footprint, cutoff)
    return _Voxelize.apply(centres, log_scales, quaternions, coefficients, grid, footprint, cutoff)  # type: ignore[return-value]


def _on_gpu(centres: Tensor) -> bool:
    return centres.device.type == "cuda" and find_spec("triton") is not None


class _Voxelize(torch.autograd.Function):
    @staticmethod
    def forward(ctx, centres, log_scales, quaternions, coefficients, grid, footprint, cutoff):
        scene = Scene(centres, log_scales, quaternions, coefficients, grid, footprint, cutoff)
        ctx.scene, ctx.dtype, ctx.device = scene, centres.dtype, centres.device
        return torch.from_numpy(scene.volume()).to(device=ctx.device, dtype=coefficients.dtype)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, *cotangents):
        gradients = ctx.scene.gradients(cotangents[0])
        return *(torch.from_numpy(g).to(device=ctx.device, dtype=ctx.dtype) for g in gradients), None, None, None
