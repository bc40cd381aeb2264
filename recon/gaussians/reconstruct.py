"""From a dataset to a model: decomposition, first volumes, first Gaussians, fit. Nothing in here knows the truth."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float

from phantomgen.dataset.reader import Dataset
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.runtime.stopwatch import Stopwatch
from recon.data.array_store import IN_MEMORY, ArrayStore
from recon.data.coverage import Coverage, inner_box
from recon.data.devices import device_named
from recon.data.inpainting import inpainted
from recon.data.material_decomposition import decompose_views
from recon.data.measurements import Measurements, matching_bin
from recon.data.view_subsets import every, kinds_of, rounds_of
from recon.gaussians.fitted_grid import read_with_coverage
from recon.gaussians.initial.fit_to_volume import evaluations_for, fit_to_volume, metric_of
from recon.gaussians.initial.initialize import initialize
from recon.gaussians.model import Gaussians
from recon.gaussians.optimize import Progress, fit
from recon.gaussians.processes import ALONE, Processes
from recon.gaussians.recipe import Recipe
from recon.gaussians.state import FitState
from recon.gaussians.unseen_rays import UnseenRays, with_rays_apart
from recon.gaussians.voxel_prior import VoxelPrior
from recon.voxel.initial_volumes import initial_volumes, starting_method
from recon.voxel.iterative.multigrid import occupied
from recon.voxel.iterative.one_step import OneStep
from recon.voxel.method import CountsMethod, Method, OnIteration, unwatched
from recon.voxel.model import Voxels
from recon.voxel.unreliable import Unreliable, unreliable_voxels
from spectra.errors import InputError
from spectra.threads import without_other_pools
from spectra.transmission import Transmission

_FISHER_VIEWS = 8  # one of so many views of each kind tells the mean information of rays
_AIR = 3  # voxels around a grid that has grown


@dataclass
class Reconstruction:
    """What a run found out.

    Parameters
    ----------
    gaussians : the fitted model
    start : name of the method that made the volumes to start from
    initial_volumes : those [1/mm]
    node_error : worst error of the log counts from compressing the energy grid
    transmission : the spectral model of the fit
    seconds : time per stage
    notes : what a user should know of how the fit went, in sentences
    coverage : what the scan covers of its object; None where nobody has looked
    unreliable : voxels whose bases the counts do not tell; None where there are none, or nobody has looked
    """

    gaussians: Gaussians
    start: str
    initial_volumes: Float[np.ndarray, "basis z y x"]
    node_error: float
    transmission: Transmission
    seconds: dict[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    coverage: Coverage | None = None
    unreliable: Unreliable | None = None


@runtime_checkable
class CheckpointStore(Protocol):
    """What keeps a fit that may be interrupted, as `recon.runs.unfinished_run.PartialRun` does."""

    def found(self, measured: Measurements) -> tuple[FitState, np.ndarray, dict[str, float]] | None:
        """Where an interrupted fit stands, what it started from, and the seconds that took."""

    def begin(self, volumes: np.ndarray, seconds: dict[str, float], state: FitState) -> None:
        """A fit begins."""


@without_other_pools()
def reconstruct(
    dataset: Dataset,
    recipe: Recipe,
    bases: int | None = None,
    on_stage: Callable[[str], None] = lambda name: None,
    on_step: Callable[[Progress], bool | None] = lambda progress: None,
    checkpoints: CheckpointStore | None = None,
    processes: Processes = ALONE,
    store: ArrayStore = IN_MEMORY,
    on_iteration: OnIteration = unwatched,
    device: str = "cpu",
) -> Reconstruction:
    """Fit Gaussians to the training views of a dataset.

    Parameters
    ----------
    dataset : an open dataset; only ``/entry`` is read
    recipe : hyper-parameters
    bases : how many of the dataset's basis functions to use, default all
    on_stage, on_step : called when a stage begins, and after each step of the fit, which ends where that returns True
    checkpoints : knows where an interrupted fit stands, and is told where a new one starts
    processes : that share the fit; the first one makes the start
    store : where counts and line integrals live
    on_iteration : called along the start, after every pass of voxels and every evaluation of Gaussians that follow them
    device : where Gaussians are computed, ``cpu`` or ``cuda``; voxels are on the processor
    """
    place = device_named(device)
    grid, voxel = dataset.grid, min(dataset.grid.spacing)
    starting_method(dataset.geometry[dataset.splits["train"]], grid)  # refuses scans that show no depth
    stage = Stopwatch(on_stage)
    with stage("read"):
        measured, node_error, covered = read_with_coverage(dataset, recipe, bases, store)
        grid = covered.grid  # with a margin where the object leaves the panel or the grid; it is cut off in the end
        if recipe.prior:
            measured = with_rays_apart(measured, voxel, recipe.seed)
        fitted, held_out = _set_apart(measured, recipe)
        fisher = _mean_information(measured, voxel, recipe)
        kept = checkpoints.found(measured) if checkpoints is not None and processes.first else None
    if kept is not None:
        state, volumes, seconds = kept
        stage.seconds.update(seconds | {"fit": state.seconds})
    elif processes.first:
        air = _AIR if grid != dataset.grid else 0
        volumes, start = _first_guess(measured, grid, air, fisher, recipe, stage, store, on_iteration, place)
        state = FitState.begin(start)
        if checkpoints is not None:
            checkpoints.begin(volumes, stage.seconds, state)
    else:
        state, volumes = None, np.zeros((len(measured.basis_names), *grid.shape), np.float32)
    state, volumes = _shared(state, processes).to(place), processes.from_first(volumes)
    anchor = None
    if recipe.prior:
        along = recipe.prior_along_edges(rounds_of(kinds_of(fitted.exposure)))
        filled = _filled_part(volumes, grid, _AIR if grid != dataset.grid else 0)
        anchor = VoxelPrior.off_edges(*filled, fisher, recipe.prior, along).holding(measured.basis_names)
    with stage("fit"):
        gaussians = fit(state, fitted, voxel, recipe, on_step, held_out, processes, anchor, store)
    name, notes = _starting(measured, grid, recipe).name, ()
    if recipe.prior:
        with stage("judge"):
            rays = UnseenRays.of(measured, voxel, recipe)
            gaussians, notes = rays.better_of(state.begun, gaussians, Voxels(volumes, grid, measured.basis_names))
    volumes = np.ascontiguousarray(volumes[:, *inner_box(dataset.grid, grid)])
    gaussians, unreliable = gaussians.to("cpu"), None
    if processes.first:
        with stage("mark"):
            unreliable = unreliable_voxels(gaussians.volume(dataset.grid), measured, dataset.grid, recipe.dispersion)
    return Reconstruction(
        gaussians, name, volumes, node_error, measured.transmission, stage.seconds, notes, covered, unreliable
    )


def _starting(measured: Measurements, grid: Grid, recipe: Recipe) -> Method:
    """What makes the first volumes: the voxels that the prior wants, or decomposed rays without one."""
    if not recipe.prior:
        return starting_method(measured.geometry, grid)
    coarse = OneStep().levels[:-1]
    return OneStep(levels=(*coarse, (1, recipe.voxel_passes)))


def _mean_information(measured: Measurements, voxel: float, recipe: Recipe) -> Float[np.ndarray, "basis basis"]:
    """Fisher matrix of line integrals, averaged over rays of some views."""
    some = measured.completed(every(kinds_of(measured.exposure), _FISHER_VIEWS))
    return decompose_views(some.binned(matching_bin(measured.geometry, voxel)), recipe.dispersion)[1]


def _first_guess(
    measured: Measurements,
    grid: Grid,
    air: int,
    fisher: Float[np.ndarray, "basis basis"],
    recipe: Recipe,
    stage: Stopwatch,
    store: ArrayStore,
    on_iteration: OnIteration,
    place: torch.device,
) -> tuple[Float[np.ndarray, "basis z y x"], Gaussians]:
    """First volumes, and Gaussians that follow them."""
    voxel, method = min(grid.spacing), _starting(measured, grid, recipe)
    if isinstance(method, CountsMethod):
        with stage(method.name):
            volumes = method.reconstruct_counts(measured, grid, on_iteration)
    else:
        coarse = measured.completed().binned(matching_bin(measured.geometry, voxel))
        with stage("decompose"):
            line_integrals = decompose_views(coarse, recipe.dispersion, store)[0]
            for image in line_integrals if coarse.unseen.any() else ():
                image[:] = inpainted(image, coarse.unseen)
        with stage(method.name):
            volumes = initial_volumes(line_integrals, coarse.unseen, coarse.geometry, grid, method)
    with stage("initialize"):
        seen, inner = _filled_part(volumes, grid, air)
        spacing = recipe.distance(len(measured)) * voxel
        gaussians = initialize(seen, inner, fisher, spacing, measured.basis_names, recipe.seed)
    if not recipe.prior:
        return volumes, gaussians
    metric = metric_of(seen, fisher)
    with stage("approximate"):
        evaluations = evaluations_for(len(gaussians), recipe.approximation)
        gaussians = fit_to_volume(gaussians.to(place), seen, inner, metric, evaluations, on_iteration)
    return volumes, gaussians.to("cpu")


def _filled_part(
    volumes: Float[np.ndarray, "basis z y x"], grid: Grid, air: int
) -> tuple[Float[np.ndarray, "..."], Grid]:
    """Volumes where they hold something, and the grid of that part; with so many voxels of air added around a grid.

    A grid that has grown ends where its object does, and Gaussians must not reach beyond for nothing.
    """
    if air:
        volumes = np.pad(volumes, ((0, 0), *[(air, air)] * 3))
        origin = tuple(o - air * s for o, s in zip(grid.origin, grid.spacing, strict=True))
        grid = Grid(tuple(n + 2 * air for n in grid.shape), grid.spacing, origin)  # type: ignore[arg-type]
    box = occupied(volumes)
    return np.ascontiguousarray(volumes[:, *box]), grid.part(box)


def _set_apart(measured: Measurements, recipe: Recipe) -> tuple[Measurements, Measurements | None]:
    """Views to fit, and those held out, which the seed picks; the start may use all."""
    if recipe.held_out == 0:
        return measured, None
    if recipe.held_out >= len(measured):
        raise InputError(f"of {len(measured)} training views, {recipe.held_out} cannot be held out: some must be left")
    picked = np.sort(np.random.default_rng(recipe.seed).choice(len(measured), recipe.held_out, replace=False))
    return measured[np.setdiff1d(np.arange(len(measured)), picked)], measured[picked]


def _shared(state: FitState | None, processes: Processes) -> FitState:
    """The state of the first process, in all."""
    parts = processes.from_first(None if state is None else (state.tensors(), state.numbers()))
    return state if state is not None else FitState.restore(*parts)  # type: ignore[misc]
