"""From a dataset to a model: decomposition, FDK, first Gaussians, fit. Nothing in here knows the truth."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from phantomgen.dataset import Dataset
from phantomgen.geometry import Geometry
from phantomgen.grid import Grid
from recon.baselines.fdk import fdk
from recon.decompose import decompose_views
from recon.fitting import Progress, fit
from recon.gaussians import Gaussians
from recon.initialize import initialize
from recon.measurements import Measurements, read_measurements
from recon.recipe import Recipe
from recon.stopwatch import Stopwatch
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
    stage = Stopwatch(on_stage)
    grid = dataset.grid
    with stage("read"):
        measured, node_error = read_measurements(dataset, dataset.splits["train"], bases).compressed(recipe.node_tolerance)
        factor = matching_bin(measured.geometry, grid)
    with stage("decompose"):
        coarse = measured.binned(factor)
        line_integrals, fisher = decompose_views(coarse, recipe.dispersion)
    with stage("fdk"):
        volumes = fdk(line_integrals, coarse.geometry, grid)
    with stage("initialize"):
        voxel = min(grid.spacing)
        start = initialize(volumes, fisher, grid, recipe.spacing * voxel, measured.basis_names, recipe.seed)
    with stage("fit"):
        stages = tuple(replace(s, binning=s.binning * factor) for s in recipe.stages)
        gaussians = fit(start, measured, voxel, replace(recipe, stages=stages), on_step)
    return Reconstruction(gaussians, volumes, node_error, stage.seconds)


def matching_bin(geometry: Geometry, grid: Grid) -> int:
    """Binning that brings pixels, seen at the isocentre, closest to a voxel without exceeding it."""
    distance = np.linalg.norm(geometry.panel_center - geometry.source, axis=1)
    magnification = float(np.median(distance / np.linalg.norm(geometry.source, axis=1)))
    pixel = min(geometry.panel.row_pitch, geometry.panel.column_pitch) / magnification
    panel = geometry.panel
    fitting = [f for f in range(1, 33) if panel.rows % f == 0 and panel.columns % f == 0]
    return max(f for f in fitting if f == 1 or f * pixel <= 1.001 * min(grid.spacing))

