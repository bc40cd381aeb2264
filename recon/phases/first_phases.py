"""First Gaussians of each phase: voxels follow the views of the phase, and Gaussians follow the voxels.

Voxels start from the volumes of all views together and make a few passes over the views of one phase. Where they vary
over the phases by no more than noise, their mean over all phases takes their place. The shared Gaussians are fitted to
this mean, and what a phase differs from it is given to the coefficients, with the shapes held. So a phase does not have
to leave the mean of all phases by steps on its counts, which would take long where few of them tell of the change.
"""

from collections.abc import Callable

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.ndimage import uniform_filter
from torch import Tensor

from phantomgen.geometry.voxel_grid import Grid
from recon.data.measurements import Measurements
from recon.data.volume_edges import BACKGROUND, large_signal
from recon.gaussians.divided.fit_to_volume import fit_divided_to_volume, solve_coefficients
from recon.gaussians.divided.model import DividedGaussians
from recon.gaussians.initial.fit_to_volume import metric_of
from recon.gaussians.model import GaussianModel
from recon.phases.settings import PhaseSettings
from recon.voxel.iterative.one_step import OneStep


def first_phases(
    shared: GaussianModel,
    measured: Measurements,
    phase_of_view: Int[np.ndarray, " view"],
    grid: Grid,
    fisher: Float[np.ndarray, "basis basis"],
    settings: PhaseSettings,
    on_phase: Callable[[int], object] = lambda phase: None,
) -> tuple[GaussianModel, Float[Tensor, "phase gaussian *side basis"]]:
    """Find the Gaussians that each phase starts from.

    Parameters
    ----------
    shared : Gaussians that were fitted to all views
    measured : these views
    phase_of_view : phase of each view, from 0 without gaps
    grid : voxels that are fitted
    fisher : information about line integrals, which weighs the bases [no unit]
    settings : passes over voxels, noise of their changes, and fits to them
    on_phase : called after each phase

    Returns
    -------
    shared Gaussians, and coefficients of each phase [1/mm]; those of all views where no planes divide the Gaussians
    """
    same, count = shared.coefficients.detach(), int(phase_of_view.max()) + 1
    if not isinstance(shared, DividedGaussians) or settings.passes == 0:
        return shared.detached(), same.expand(count, *same.shape).clone()
    static, method, volumes = shared.volume(grid), OneStep(levels=((1, settings.passes),)), []
    for phase in range(count):
        own = measured[np.flatnonzero(phase_of_view == phase)]
        volumes.append(method.reconstruct_counts(own, grid, start=static))
        on_phase(phase)
    mean, differences = changes_beyond_noise(np.stack(volumes), settings.change)
    metric = metric_of(mean, fisher)
    closer = fit_divided_to_volume(shared, mean, grid, metric, settings.evaluations).detached()
    empty = closer.with_values(torch.zeros_like(same))
    found = [solve_coefficients(empty, each, grid, metric, settings.solves).coefficients for each in differences]
    return closer, closer.coefficients + torch.stack(found).detach()


def changes_beyond_noise(
    volumes: Float[np.ndarray, "phase basis z y x"], change: float
) -> tuple[Float[np.ndarray, "basis z y x"], Float[np.ndarray, "phase basis z y x"]]:
    """Divide volumes into their mean over all phases and differences from it, less where these are noise.

    Parameters
    ----------
    volumes : of each phase [1/mm]
    change : variance over the phases, over that of noise, at which half of a difference from the mean is kept; of each
        basis, as a mean over 3 x 3 x 3 voxels [no unit]

    Returns
    -------
    mean, and the differences from it times t / (t + change t_0), with the variance t and that of noise t_0 [1/mm]

    Notes
    -----
    Second differences from phase to phase have 6 times the variance of noise, and little of what changes slowly. Their
    median over the object is that of noise also where most of the object moves.
    """
    mean = volumes.mean(axis=0)
    differences = volumes - mean
    density = mean.sum(axis=0)
    inside = density > BACKGROUND * large_signal(density)
    for basis, part in enumerate(differences.swapaxes(0, 1)):
        variance = uniform_filter(np.square(part).mean(axis=0), 3, mode="nearest")
        bends = np.diff(part, 2, axis=0) / np.sqrt(6) if len(part) > 2 else part
        noise = uniform_filter(np.square(bends).mean(axis=0), 3, mode="nearest")
        typical = float(np.median(noise[inside])) if inside.any() else 0.0
        differences[:, basis] *= variance / np.maximum(variance + change * typical, np.finfo(np.float32).tiny)
    return mean, differences
