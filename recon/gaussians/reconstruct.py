"""The whole fit, from a dataset to a model, in the order of its steps; docs/explanation/the_fit.md explains them.

Read the training views, reconstruct voxel volumes from them, place Gaussians, fit these to the volumes, fit them to the
counts, and decide by rays that none of this used whether to keep the result. The truth is never read.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from phantomgen.dataset.reader import Dataset
from phantomgen.runtime.stopwatch import Stopwatch
from recon.data.coverage import Coverage, inner_box
from recon.data.devices import device_named
from recon.data.incomplete_counts import saturation_notes
from recon.data.material_decomposition import decompose_views
from recon.data.measurements import Measurements, matching_bin
from recon.data.view_subsets import count_complete_sets, every_nth_view, view_groups
from recon.gaussians.divided.first_gaussians import divided_gaussians
from recon.gaussians.fitted_grid import read_with_coverage
from recon.gaussians.initial.first_guess import Scan, first_guess, part_with_gaussians, plain_gaussians, start_method
from recon.gaussians.model import GaussianModel
from recon.gaussians.optimize import OnStep, Progress, fit
from recon.gaussians.processes import LOCAL, Processes, Resources
from recon.gaussians.recipe import Recipe
from recon.gaussians.state import FitState, InterruptedFit
from recon.gaussians.unseen_rays import UnseenRays, with_unseen_rays
from recon.gaussians.voxel_prior import VoxelPrior
from recon.voxel.initial_volumes import starting_method
from recon.voxel.method import OnIteration, no_callback
from recon.voxel.model import Voxels
from recon.voxel.unreliable import Unreliable, unreliable_voxels
from spectra.errors import InputError
from spectra.threads import without_other_pools
from spectra.transmission import Transmission


@dataclass
class Reconstruction:
    """The result of a fit.

    Parameters
    ----------
    gaussians : the fitted model
    start : name of the method that made the volumes to start from
    initial_volumes : these volumes, (M, Z, Y, X) [1/mm]
    node_error : largest error of the log counts from compressing the energy grid [no unit]
    transmission : spectral model of the fit
    seconds : time of each stage, by name [s]
    notes : sentences of warning for the user about the course of the fit
    coverage : what the scan covers of its object; None where it was not computed
    unreliable : voxels whose bases the counts do not determine; None where there are none or they were not computed
    volumes : of the model on the grid of the dataset, (M, Z, Y, X) [1/mm]; None where they were not computed
    told : sentences about what was chosen, which are no warnings
    """

    gaussians: GaussianModel
    start: str
    initial_volumes: Float[np.ndarray, "basis z y x"]
    node_error: float
    transmission: Transmission
    seconds: dict[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    coverage: Coverage | None = None
    unreliable: Unreliable | None = None
    volumes: Float[np.ndarray, "basis z y x"] | None = None
    told: tuple[str, ...] = ()


@runtime_checkable
class CheckpointStore(Protocol):
    """Storage for fits that may be interrupted, such as `recon.runs.unfinished_run.PartialRun`."""

    def found(self, measured: Measurements) -> InterruptedFit | None:
        """Return an interrupted fit of these views, if there is one.

        Parameters
        ----------
        measured : training views, unbinned
        """

    def begin(self, volumes: np.ndarray, seconds: dict[str, float], state: FitState) -> None:
        """Store what a fit starts from.

        Parameters
        ----------
        volumes : volumes of the start, (M, Z, Y, X) [1/mm]
        seconds : time of each stage so far, by name [s]
        state : the fit before its first step
        """


@without_other_pools()
def reconstruct(
    dataset: Dataset,
    recipe: Recipe,
    bases: int | None = None,
    on_stage: Callable[[str], None] = lambda name: None,
    on_step: OnStep = lambda progress: None,
    checkpoints: CheckpointStore | None = None,
    on_iteration: OnIteration = no_callback,
    resources: Resources = LOCAL,
) -> Reconstruction:
    """Fit Gaussians to the training views of a dataset.

    Parameters
    ----------
    dataset : an open dataset; only ``/entry`` is read
    recipe : settings
    bases : how many of the dataset's basis functions to use, default all
    on_stage : called with the name of each stage when it begins
    on_step : called after each step of the fit, which ends where it returns True; then nothing is judged, and no
        residual computed
    checkpoints : returns an interrupted fit, and stores what a new one starts from
    on_iteration : called after every pass over voxels, and after every evaluation of the fit to the volumes
    resources : processes that share the fit, of which the first one makes the start; device; where arrays are kept

    Returns
    -------
    the fitted model, and what is known of the fit
    """
    processes, device = resources.processes, device_named(resources.device)
    starting_method(dataset.geometry[dataset.splits["train"]], dataset.grid)  # refuses views from one side alone
    stage = Stopwatch(on_stage)
    with stage("read"):
        scan = _read(dataset, recipe, bases, resources)
        measured, grid = scan.measured, scan.coverage.grid
        fitted, held_out = _split(measured, recipe)
        kept = checkpoints.found(measured) if checkpoints is not None and processes.first else None
    if kept is not None:
        state, volumes = kept.state, kept.volumes
        stage.seconds.update(kept.seconds | {"fit": state.seconds})
    elif processes.first:
        place = divided_gaussians if recipe.kernel == "interface" else plain_gaussians
        volumes, start = first_guess(scan, recipe, stage, on_iteration, resources, place)
        state = FitState.begin(start)
        if checkpoints is not None:
            checkpoints.begin(volumes, stage.seconds, state)
    else:
        state, volumes = None, np.zeros((len(measured.basis_names), *grid.shape), np.float32)
    state, volumes = _shared(state, processes).to(device), processes.from_first(volumes)
    voxel = min(dataset.grid.spacing)
    prior = _prior_of(volumes, scan, fitted, recipe) if recipe.prior else None
    ended: list[int] = []  # the step after which `on_step` ended the fit; what follows is for whole fits

    def watched(progress: Progress) -> bool:
        stop = bool(on_step(progress))
        ended.extend([progress.step] if stop and progress.step < progress.steps else [])
        return stop

    with stage("fit"):
        gaussians = fit(state, fitted, voxel, recipe, watched, held_out, prior, resources)
    notes, told = (), ()
    if recipe.prior and not ended:
        with stage("judge"):
            rays = UnseenRays.of(measured, voxel, recipe.dispersion, recipe.unseen_rays)
            gaussians, notes = rays.better_of(state.initial, gaussians, Voxels(volumes, grid, measured.basis_names))
    notes = (*saturation_notes(dataset.spectra.channels, measured.bounded), *notes)
    volumes = np.ascontiguousarray(volumes[:, *inner_box(dataset.grid, grid)])
    gaussians, unreliable, result = gaussians.to("cpu"), None, None
    if recipe.residual.passes and processes.first and not ended:
        with stage("residual"):
            gaussians, told = _with_residual(gaussians, scan, recipe, on_iteration, resources.device)
    if processes.first:
        with stage("mark"):
            result = gaussians.volume(dataset.grid)
            if recipe.curve is None:  # on a curve, one number determines all bases
                unreliable = unreliable_voxels(result, measured, dataset.grid, recipe.dispersion)
    return Reconstruction(
        gaussians,
        start_method(measured, grid, recipe).name,
        volumes,
        scan.node_error,
        measured.transmission,
        stage.seconds,
        notes,
        scan.coverage,
        unreliable,
        result,
        told,
    )


def _read(dataset: Dataset, recipe: Recipe, bases: int | None, resources: Resources) -> Scan:
    """Read the training views, set rays apart, and compute the mean information of the rays."""
    measured, node_error, covered = read_with_coverage(dataset, recipe, bases, resources.store)
    voxel = min(dataset.grid.spacing)
    if recipe.prior:
        measured = with_unseen_rays(measured, voxel, recipe.seed, recipe.unseen_rays)
    air = recipe.margin_air if covered.grid != dataset.grid else 0
    return Scan(measured, node_error, covered, _mean_information(measured, voxel, recipe), air)


def _mean_information(measured: Measurements, voxel: float, recipe: Recipe) -> Float[np.ndarray, "basis basis"]:
    """Compute the Fisher matrix of line integrals, averaged over the rays of some views."""
    some = measured.completed(every_nth_view(view_groups(measured.exposure), recipe.information_step))
    coarse = some.binned(matching_bin(measured.geometry, voxel))
    if recipe.curve is not None:
        from recon.gaussians.on_curve.information import mean_information  # noqa: PLC0415 - only on a curve

        return mean_information(coarse, recipe.curve, recipe.dispersion)
    return decompose_views(coarse, recipe.dispersion)[1]


def _split(measured: Measurements, recipe: Recipe) -> tuple[Measurements, Measurements | None]:
    """Split the views into those to fit and those held out, which the seed selects; the start may use all."""
    if recipe.held_out == 0:
        return measured, None
    if recipe.held_out >= len(measured):
        raise InputError(f"of {len(measured)} training views, {recipe.held_out} cannot be held out: some must be left")
    picked = np.sort(np.random.default_rng(recipe.seed).choice(len(measured), recipe.held_out, replace=False))
    return measured[np.setdiff1d(np.arange(len(measured)), picked)], measured[picked]


def _with_residual(
    gaussians: GaussianModel, scan: Scan, recipe: Recipe, on_iteration: OnIteration, device: str
) -> tuple[GaussianModel, tuple[str, ...]]:
    """Add a residual in voxels, where rays that took no part confirm it; a sentence says whether."""
    measured, grid = scan.measured, scan.coverage.grid
    if measured.unseen_blocks is None:
        measured = with_unseen_rays(measured, min(grid.spacing), recipe.seed, recipe.unseen_rays)
    rays = UnseenRays.of(measured, min(grid.spacing), recipe.dispersion, recipe.unseen_rays)
    from recon.gaussians.residual.fit_residual import with_residual  # noqa: PLC0415 - only where it is asked for

    found = with_residual(gaussians, measured, grid, recipe.residual, on_iteration, device)
    return rays.with_or_without(found, gaussians, recipe.residual.worth)


def _prior_of(
    volumes: Float[np.ndarray, "basis z y x"], scan: Scan, fitted: Measurements, recipe: Recipe
) -> VoxelPrior:
    """Make the voxel prior of the volumes that the fit started from."""
    trust = recipe.prior_along_edges(count_complete_sets(view_groups(fitted.exposure)))
    part = part_with_gaussians(volumes, scan, recipe)
    prior = VoxelPrior.of_volumes(*part, scan.fisher, recipe.prior, trust, recipe.voxel_prior)
    if recipe.curve is not None:
        from recon.gaussians.on_curve.directions import AlongCurve  # noqa: PLC0415 - only on a curve

        return replace(prior, on_curve=AlongCurve.of_volumes(recipe.curve, *part))
    return prior.holding_kedges(scan.measured.basis_names)


def _shared(state: FitState | None, processes: Processes) -> FitState:
    """Send the state of the first process to all."""
    parts = processes.from_first(None if state is None else (state.tensors(), state.numbers()))
    return state if state is not None else FitState.restore(*parts)  # type: ignore[misc]
