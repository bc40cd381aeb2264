"""The fit of a residual: voxels take what Gaussians leave unexplained, where it exceeds the noise.

The one-step voxel method goes on from the volumes of the Gaussians, and its total variation is that of what it adds. So
edges stay those of the Gaussians, and only what the counts tell beyond noise is added. Voxels project less exactly than
Gaussians: the counts are multiplied by what the voxels expect of the Gaussians' volumes over what the Gaussians expect,
so that a residual of 0 explains them as well as the Gaussians do.
"""

from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Float

from phantomgen.geometry.voxel_grid import Grid
from recon.data.devices import device_named
from recon.data.measurements import Measurements, matching_bin
from recon.data.pixel_blocks import sum_blocks
from recon.gaussians.model import GaussianModel
from recon.gaussians.residual.model import GaussiansWithResidual
from recon.gaussians.settings import ResidualSettings
from recon.voxel.iterative.one_step import OneStep
from recon.voxel.method import OnIteration, no_callback
from recon.voxel.model import Voxels

MOST_CORRECTION = 2.0  # factor of the counts; it is passed behind thick metal alone, whose rays weigh little


def with_residual(
    gaussians: GaussianModel,
    measured: Measurements,
    grid: Grid,
    settings: ResidualSettings,
    on_iteration: OnIteration = no_callback,
    device: str = "cpu",
) -> GaussiansWithResidual:
    """Add to Gaussians what they leave unexplained.

    Parameters
    ----------
    gaussians : the fitted model, on the processor
    measured : training views, unbinned
    grid : voxels of the residual
    settings : passes over the views, strength of the total variation, and what counts as nothing
    on_iteration : called after every pass
    device : where voxels are computed, ``cpu`` or ``cuda``

    Returns
    -------
    the Gaussians with their residual
    """
    method = OneStep(levels=((1, settings.passes),), strength=settings.strength, device=device)
    volumes = gaussians.volume(grid)
    factor, there = (
        matching_bin(measured.geometry, method.pixel * min(grid.spacing)),
        gaussians.to(device_named(device)),
    )
    data = as_voxels_project(measured, factor, there, Voxels(volumes, grid, gaussians.basis_names))
    added = method.refine(volumes, data, grid, on_iteration) - volumes
    peaks = volumes.max(axis=(1, 2, 3), keepdims=True)
    places = np.flatnonzero((np.abs(added) > settings.least * peaks).any(axis=0))
    values = np.ascontiguousarray(added.reshape(len(added), -1)[:, places].T)
    return GaussiansWithResidual(gaussians, torch.from_numpy(places), torch.from_numpy(values), grid)


def as_voxels_project(measured: Measurements, factor: int, model: GaussianModel, voxels: Voxels) -> Measurements:
    """Sum pixels, and correct their counts for what voxels and blocks of pixels do not resolve and a model does.

    The correction replaces the one of `Measurements.binned` for partial volume, as the model knows the line
    integrals of every pixel of a block.

    Parameters
    ----------
    measured : views, unbinned
    factor : pixels along each side of a block
    model : Gaussians
    voxels : their volumes

    Returns
    -------
    the binned scan, with counts times what the volumes expect in a block over what the Gaussians expect in its pixels
    """
    coarse = measured.summed(factor)
    counts = np.empty(coarse.counts.shape, np.float32)
    with torch.no_grad():
        for view in range(len(measured)):
            exact = sum_blocks(_expected(measured, model, view), factor)
            ratio = _expected(coarse, voxels, view) / np.maximum(exact, np.finfo(np.float32).tiny)
            counts[view] = coarse.counts[view] * np.clip(ratio, 1 / MOST_CORRECTION, MOST_CORRECTION)
    return replace(coarse, counts=counts)


def _expected(
    measured: Measurements, model: GaussianModel | Voxels, view: int
) -> Float[np.ndarray, "channel row column"]:
    """Expected counts of a view at exposure 1."""
    lengths = np.moveaxis(model.line_integrals(measured.geometry[[view]])[0].cpu().numpy(), 0, -1)
    return measured.gains * np.moveaxis(measured.transmission.expected(measured.with_profile(lengths)), -1, 0)
