"""Runs that fit Gaussians, by this project's method or by the paper's: basis, memory, checkpoints, and the fit."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np

from phantomgen.dataset.reader import Dataset
from phantomgen.runtime.plain_json import write_json
from phantomgen.runtime.stopwatch import Stopwatch
from recon.data.array_store import array_store
from recon.figures.run_figures import convergence
from recon.gaussians.fitted_grid import fitted_grid
from recon.gaussians.optimize import Progress
from recon.gaussians.processes import ALONE, Processes, Resources
from recon.gaussians.recipe import PLAIN_RECIPES, RECIPES, Recipe, with_count, with_detail, with_residual_in_voxels
from recon.gaussians.reconstruct import Reconstruction, reconstruct
from recon.kedge.basis_names import Asked, OnCurve, left_out, with_named
from recon.kedge.choose_basis import BasisChoice, choose_basis
from recon.kedge.report import draw_choice
from recon.published_methods.paper.recipe import PaperRecipe
from recon.published_methods.paper.reconstruct import reconstruct_paper
from recon.runs.interfaces import Watcher
from recon.runs.memory_plan import MemoryPlan, plan_memory
from recon.runs.outcomes.volume_outcome import VolumeOutcome
from recon.runs.unfinished_run import Interruption, PartialRun
from recon.runs.write_run import Stopped
from recon.voxel.initial_volumes import check_directions
from spectra.errors import InputError

AnyRecipe = TypeVar("AnyRecipe", bound=Recipe | PaperRecipe)


class Fitted(NamedTuple):
    """What is fitted.

    Parameters
    ----------
    dataset : in the basis functions that were named or chosen
    count : how many of them to fit; None for all
    choice : of basis functions; None for the paper's method, which fits those that are asked for
    """

    dataset: Dataset
    count: int | None
    choice: BasisChoice | None


@dataclass(frozen=True)
class GaussianRun:
    """A fit of Gaussians with all that steers it; a `recon.runs.interfaces.RunMethod`.

    Parameters
    ----------
    recipe : hyper-parameters of this project's fit, or of the paper's method
    bases : how many basis functions to fit, or their names; None for those that the counts warrant, while the paper's
        method takes all
    edges : where to look for K edges [keV], see `recon.kedge.choose_basis.choose_basis`; None to believe the dataset
    memory : largest memory to take [GiB], see `recon.runs.memory_plan`; None for no limit
    processes : that share the fit
    device : where Gaussians are computed, ``cpu`` or ``cuda``
    """

    recipe: Recipe | PaperRecipe
    bases: Asked = None
    edges: Sequence[float] | None = None
    memory: float | None = None
    processes: Processes = ALONE
    device: str = "cpu"

    def check(self, dataset: Dataset) -> None:
        """Refuse a scan whose views all have the same direction, and a recipe that takes no curve of materials.

        Parameters
        ----------
        dataset : open dataset, of which counts are not read

        Raises
        ------
        GeometryError
            When it is such a scan.
        InputError
            When a curve is asked for and the recipe takes none.
        """
        check_directions(dataset.geometry[dataset.splits["train"]])
        on_curve(self.recipe, self.bases, dataset)

    def reconstruct(self, dataset: Dataset, folder: Path | None, clock: Stopwatch, watcher: Watcher) -> VolumeOutcome:
        """Choose the basis and fit Gaussians to the training views; continue from a checkpoint in the folder.

        Parameters
        ----------
        dataset : open dataset; only ``/entry`` is read
        folder : run folder, for checkpoints and the log; None where another process writes it
        clock : times the stages
        watcher : shows the progress

        Returns
        -------
        the finished fit

        Raises
        ------
        Stopped
            When Ctrl-C ended the fit after a step; the model is in the folder.
        """
        stated, fitted = dataset.spectra.basis.names, self._fitted(dataset, clock, watcher)
        recipe = on_curve(self.recipe, self.bases, fitted.dataset)
        unfinished = None
        if folder is not None:
            options = {"grid": dataset.grid, **{f.name: getattr(recipe, f.name) for f in fields(recipe)}}
            unfinished = PartialRun(folder, dataset.spectra.channels, options)
        last: list[Progress] = []
        with Interruption() as interruption:

            def on_step(progress: Progress) -> bool:
                last[:] = [progress]
                if unfinished is not None:
                    unfinished.add(progress)
                watcher.step(progress)
                return interruption.asked

            if isinstance(recipe, PaperRecipe):
                result = reconstruct_paper(fitted.dataset, recipe, fitted.count, watcher.stage, on_step)
            else:
                place = folder or Path()
                plan = self._memory_plan(fitted, recipe, place, clock)
                with array_store(place, plan.on_disk) as store:
                    result = reconstruct(
                        fitted.dataset,
                        recipe,
                        fitted.count,
                        watcher.stage,
                        on_step,
                        unfinished,
                        watcher.iterated,
                        Resources(self.processes, store, self.device),
                    )
        clock.seconds.update(result.seconds)
        missing = left_out(stated, result.gaussians.basis_names)
        outcome = outcome_of_fit(fitted.dataset, recipe, result, fitted.choice, missing)
        if unfinished is None:
            return outcome
        if interruption.asked and last and last[0].step < last[0].steps:
            outcome.write_model(unfinished.folder)
            raise _stopped(last[0], unfinished)
        for sentence in (*result.told, *result.notes):  # of a whole fit; a part of it tells nothing
            watcher.note(sentence)
        seconds, deviances = (np.array([entry[key] for entry in unfinished.log]) for key in ("seconds", "deviance"))
        more: dict[str, Callable[[Path], Any]] = {"convergence.png": partial(convergence, seconds, deviances)}
        if fitted.choice is not None:
            more["edge.png"] = partial(draw_choice, fitted.choice, fitted.dataset)
        return replace(outcome, log=unfinished, figures=more)

    def _fitted(self, dataset: Dataset, clock: Stopwatch, watcher: Watcher) -> Fitted:
        """Choose the basis functions by the counts, or take those that were named."""
        if isinstance(self.recipe, PaperRecipe):
            return Fitted(*with_named(dataset, self.bases), None)
        with clock("basis"):
            choice = choose_basis(dataset, self.bases, self.edges)
            for sentence in choice.sentences:
                watcher.note(sentence)
            return Fitted(dataset.with_basis(choice.basis), None, choice)

    def _memory_plan(self, fitted: Fitted, recipe: Recipe, folder: Path, clock: Stopwatch) -> MemoryPlan:
        """Plan memory; where it is limited, for the grid with the margin of a truncated scan."""
        plan = plan_memory(fitted.dataset, recipe, fitted.count, self.memory)
        if self.memory is None:
            return plan
        with clock("check"):
            grid = fitted_grid(fitted.dataset, recipe, fitted.count, folder)
        return plan_memory(fitted.dataset, recipe, fitted.count, self.memory, grid=grid)


def chosen_recipe(
    name: str,
    sweeps: float | None,
    seed: int,
    held_out: int,
    kernel: str = "interface",
    detail: float = 1.0,
    count: int = 0,
    residual: bool = False,
) -> Recipe:
    """Return a recipe of this project with what a user chose.

    Parameters
    ----------
    name : ``fast`` or ``best``
    sweeps : number of times that every stage uses each training view, however few the views are; None for that of the
        recipe
    seed : of all that is random
    held_out : number of training views that only tell when to stop
    kernel : ``interface`` or ``gaussian``
    detail : factor by which Gaussians are closer to each other than in the recipe
    count : number of Gaussians; 0 for as many as the distances give
    residual : whether voxels take what Gaussians leave unexplained

    Returns
    -------
    the recipe
    """
    recipes = RECIPES if kernel == "interface" else PLAIN_RECIPES
    recipe = with_count(with_detail(replace(recipes[name], seed=seed, held_out=held_out), detail), count)
    recipe = with_residual_in_voxels(recipe) if residual else recipe
    if sweeps is None:
        return recipe
    return replace(
        recipe,
        most_turns=1.0,
        stages=tuple(replace(stage, sweeps=sweeps) for stage in recipe.stages),
    )


def on_curve(recipe: AnyRecipe, bases: Asked, dataset: Dataset) -> AnyRecipe:
    """Add the curve of materials to a recipe where one is asked for.

    Parameters
    ----------
    recipe : without a curve
    bases : basis functions as a user asks for them
    dataset : whose basis functions and spectrum the curve has

    Returns
    -------
    the recipe with the curve, or as it is

    Raises
    ------
    InputError
        When the recipe takes no curve.
    """
    if not isinstance(bases, OnCurve):
        return recipe
    if isinstance(recipe, PaperRecipe):
        raise InputError("the recipe paper takes no curve of materials: take the recipe fast or best, or other bases")
    return replace(recipe, curve=bases.curve(with_named(dataset, bases)[0]))


def outcome_of_fit(
    dataset: Dataset,
    recipe: Recipe | PaperRecipe,
    result: Reconstruction,
    choice: BasisChoice | None,
    left_out: tuple[str, ...],
) -> VolumeOutcome:
    """Return a finished fit in the form in which it is written, scored and drawn.

    Parameters
    ----------
    dataset : open dataset in the basis functions from which those of the model were chosen
    recipe : of the fit
    result : of the fit
    choice : of basis functions; None where there was none
    left_out : names of the dataset's basis functions that are not fitted

    Returns
    -------
    the outcome, without a log and without figures of its own
    """
    about = {
        "dataset": dataset.path.name,
        "seed": recipe.seed,
        "gaussians": len(result.gaussians),
    }
    about |= {"start": result.start, "notes": [*result.told, *result.notes]}
    about |= {} if choice is None else {"basis_choice": choice.record()}
    if isinstance(recipe, Recipe) and recipe.curve is not None:
        about |= {"curve": asdict(recipe.curve)}
    about |= {"recipe": recipe.description if isinstance(recipe, PaperRecipe) else recipe.name}
    settings = {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(recipe).items()}
    return VolumeOutcome(
        dataset, result.gaussians, result.transmission, about, settings, result.node_error,
        coverage=result.coverage, unreliable=result.unreliable, left_out=left_out, notes=result.notes,
        start={result.start: result.initial_volumes}, computed=result.volumes,
    )  # fmt: skip


def _stopped(progress: Progress, unfinished: PartialRun) -> Stopped:
    """Write a checkpoint, if the fit can go on from one, and how far the model is."""
    if progress.state is not None:
        unfinished.save(progress.state)
    done = {"gaussians": len(progress.gaussians), "step": progress.step, "steps": progress.steps}
    write_json(unfinished.folder / "metrics.json", {"interrupted": done})
    return Stopped(f"after step {progress.step} of {progress.steps}")
