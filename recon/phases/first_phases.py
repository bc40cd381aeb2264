"""First coefficients of each phase: voxels follow the views of the phase, and Gaussians follow the voxels.

Voxels start from the volumes of all views together and make a few passes over the views of one phase. What they change
is given to the coefficients, with the shapes held. So a phase does not have to leave the mean of all phases by steps
on its counts, which would take long where few of them tell of the change.
"""

from collections.abc import Iterator

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from phantomgen.geometry.voxel_grid import Grid
from recon.data.measurements import Measurements
from recon.gaussians.divided.fit_to_volume import solve_coefficients
from recon.gaussians.divided.model import DividedGaussians
from recon.gaussians.initial.fit_to_volume import metric_of
from recon.gaussians.model import GaussianModel
from recon.phases.settings import PhaseSettings
from recon.voxel.iterative.one_step import OneStep


def first_coefficients(
    shared: GaussianModel,
    measured: Measurements,
    phase_of_view: Int[np.ndarray, " view"],
    grid: Grid,
    fisher: Float[np.ndarray, "basis basis"],
    settings: PhaseSettings,
) -> Iterator[Float[Tensor, "gaussian *side basis"]]:
    """Find the coefficients that each phase starts from.

    Parameters
    ----------
    shared : Gaussians that were fitted to all views
    measured : these views
    phase_of_view : phase of each view, from 0 without gaps
    grid : voxels that are fitted
    fisher : information about line integrals, which weighs the bases [no unit]
    settings : passes over voxels, and solutions for coefficients

    Yields
    ------
    coefficients of each phase [1/mm]; those of all views where no planes divide the Gaussians
    """
    same, count = shared.coefficients.detach(), int(phase_of_view.max()) + 1
    if not isinstance(shared, DividedGaussians) or settings.passes == 0:
        yield from (same.clone() for _ in range(count))
        return
    static = shared.volume(grid)
    for phase in range(count):
        own = measured[np.flatnonzero(phase_of_view == phase)]
        change = OneStep(levels=((1, settings.passes),)).reconstruct_counts(own, grid, start=static) - static
        empty, metric = shared.with_values(torch.zeros_like(same)), metric_of(static, fisher)
        yield same + solve_coefficients(empty, change, grid, metric, settings.solves).coefficients.detach()
