"""From a dataset to a model: decomposition, FDK, first Gaussians, fit. Nothing in here knows the truth."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from phantomgen.dataset import Dataset
from phantomgen.stopwatch import Stopwatch
from recon.baselines.fdk import fdk
from recon.decompose import decompose_views
from recon.filling import filled
from recon.fitting import Progress, fit
from recon.gaussians import Gaussians
from recon.initialize import initialize
from recon.measurements import matching_bin, read_measurements
from recon.orbit_check import check_full_circle
from recon.recipe import Recipe
from spectra.threads import without_other_pools


@dataclass
class Reconstruction:
    """What a run found out.

    Parameters
    ----------
    gaussians : the fitted model
    fdk_volumes : filtered back-projection of the decomposed rays, what the fit started from [1/mm]
    node_error : worst error of the log counts from compressing the energy grid
    seconds : time per stage
    """

    gaussians: Gaussians
    fdk_volumes: Float[np.ndarray, "basis z y x"]
    node_error: float
    seconds: dict[str, float] = field(default_factory=dict)


@without_other_pools()
def reconstruct(
    dataset: Dataset,
    recipe: Recipe,
    bases: int | None = None,
    on_stage: Callable[[str], None] = lambda name: None,
    on_step: Callable[[Progress], None] = lambda progress: None,
) -> Reconstruction:
    """Fit Gaussians to the training views of a dataset.

    Parameters
    ----------
    dataset : an open dataset; only ``/entry`` is read
    recipe : hyper-parameters
    bases : how many of the dataset's basis functions to use, default all
    on_stage, on_step : called when a stage begins, and after each step of the fit
    """
    check_full_circle(dataset.geometry[dataset.splits["train"]])
    stage = Stopwatch(on_stage)
    grid = dataset.grid
    with stage("read"):
        measured, node_error = read_measurements(dataset, dataset.splits["train"], bases).compressed(
            recipe.node_tolerance
        )
    with stage("decompose"):
        coarse = measured.completed().binned(matching_bin(measured.geometry, min(grid.spacing)))
        line_integrals, fisher = decompose_views(coarse, recipe.dispersion)
        line_integrals = filled(line_integrals, coarse.unseen)
    with stage("fdk"):
        volumes = fdk(line_integrals, coarse.geometry, grid)
    with stage("initialize"):
        voxel = min(grid.spacing)
        start = initialize(volumes, fisher, grid, recipe.spacing * voxel, measured.basis_names, recipe.seed)
    with stage("fit"):
        gaussians = fit(start, measured, voxel, recipe, on_step)
    return Reconstruction(gaussians, volumes, node_error, stage.seconds)
