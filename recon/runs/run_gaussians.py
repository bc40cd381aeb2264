"""One whole run: reconstruct, score, write. The truth is opened only when the fit is over."""

from collections.abc import Sequence
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
import yaml

from phantomgen.dataset.reader import Dataset, open_dataset
from phantomgen.dataset.truth import Truth, read_truth
from phantomgen.runtime.guarded import Guard, Salvage, unguarded
from phantomgen.runtime.plain_json import write_json
from phantomgen.runtime.stopwatch import Stopwatch, peak_memory_mib
from phantomgen.runtime.versions import environment
from recon.data.array_store import array_store
from recon.evaluation import verdict
from recon.evaluation.scoring import psnr_of_bases, score_start, score_test_views, score_truth
from recon.figures import run_figures as figures
from recon.figures.model_figures import draw_model
from recon.gaussians.fitted_grid import fitted_grid
from recon.gaussians.model import Gaussians
from recon.gaussians.optimize import Progress
from recon.gaussians.processes import ALONE, Processes
from recon.gaussians.recipe import RECIPES, Recipe
from recon.gaussians.reconstruct import Reconstruction, reconstruct
from recon.kedge.basis_names import Asked, left_out, left_out_sentence, with_named
from recon.kedge.choose_basis import choose_basis
from recon.kedge.report import draw_choice
from recon.published_methods.paper.recipe import PaperRecipe
from recon.published_methods.paper.reconstruct import reconstruct_paper
from recon.runs.interruption import Interruption
from recon.runs.memory_plan import plan_memory
from recon.runs.run_folder import MODEL, write_scan
from recon.runs.unfinished_run import PartialRun
from recon.runs.write_run import Stopped, write_volumes
from recon.voxel.initial_volumes import check_directions
from recon.voxel.method import Iteration
from spectra.threads import without_other_pools


@runtime_checkable
class Watcher(Protocol):
    """What is told how a run goes on."""

    def stage(self, name: str) -> None:
        """A stage begins."""

    def step(self, progress: Progress) -> None:
        """A step of the fit is done."""

    def iterated(self, iteration: Iteration) -> None:
        """A part of the start is done."""

    def say(self, sentence: str) -> None:
        """Something was decided."""

    def warn(self, sentence: str, error: Exception) -> None:
        """A score or a figure failed."""


@without_other_pools()
def run(
    dataset: Dataset,
    folder: Path | None,
    bases: Asked,
    recipe: Recipe | PaperRecipe,
    figures: bool,
    watcher: Watcher,
    edges: Sequence[float] | None = None,
    memory: float | None = None,
    processes: Processes = ALONE,
    device: str = "cpu",
) -> dict[str, Any]:
    """Reconstruct, score and write everything into `folder`; returns what ``metrics.json`` holds.

    Parameters
    ----------
    dataset : an open dataset
    folder : an existing folder with a subfolder ``figures``, which may hold an interrupted run; None where another
        process writes, and then nothing is returned
    bases : how many basis functions to fit, or their names; None for those that the data warrant, while the paper's
        method takes all
    recipe : hyper-parameters of this project's fit, or of the paper's method
    figures : whether to draw
    watcher : is told about stages, steps and decisions
    edges : where to look for K edges, see `recon.kedge.choose_basis.choose_basis`; None to believe the dataset
    memory : largest memory to take [GiB]; see `recon.runs.memory_plan`
    processes : that share the fit
    device : where Gaussians are computed, ``cpu`` or ``cuda``

    Raises
    ------
    Stopped
        When Ctrl-C ended the fit after a step; the model is in the folder.

    Notes
    -----
    The model and its volumes are written first. Scores or figures that fail after that are a warning, and are named
    under ``failed`` in ``metrics.json``.
    """
    clock = Stopwatch(watcher.stage)
    with clock("check"):
        check_directions(dataset.geometry[dataset.splits["train"]])
        _check_test_views(dataset)
    choice, stated = None, dataset.spectra.basis.names
    if isinstance(recipe, Recipe):
        with clock("basis"):
            choice = choose_basis(dataset, bases, edges)
            dataset, bases = dataset.with_basis(choice.basis), None
            for sentence in choice.sentences:
                watcher.say(sentence)
    else:
        dataset, bases = with_named(dataset, bases)
    checkpoints = None if folder is None else PartialRun(folder, dataset.spectra.channels, _options(dataset, recipe))
    last: list[Progress] = []
    with Interruption() as interruption:

        def on_step(progress: Progress) -> bool:
            last[:] = [progress]
            if checkpoints is not None:
                checkpoints.add(progress)
            watcher.step(progress)
            return interruption.asked

        if isinstance(recipe, PaperRecipe):
            result = reconstruct_paper(dataset, recipe, bases, watcher.stage, on_step)
        else:
            plan = plan_memory(dataset, recipe, bases, memory)
            if memory is not None:  # a margin may need more
                with clock("check"):
                    grid = fitted_grid(dataset, recipe, bases, folder or Path())
                plan = plan_memory(dataset, recipe, bases, memory, grid=grid)
            with array_store(folder or Path(), plan.on_disk) as store:
                result = reconstruct(
                    dataset,
                    recipe,
                    bases,
                    watcher.stage,
                    on_step,
                    checkpoints,
                    processes,
                    store,
                    watcher.iterated,
                    device,
                )
    if folder is None or checkpoints is None:
        return {}
    for sentence in result.notes:
        watcher.say(sentence)
    write_model(dataset, recipe, result, folder)
    if interruption.asked and last and last[0].step < last[0].steps:
        raise _stopped(last[0], checkpoints, folder)
    with clock("write"):
        write_result(dataset, result, folder)
    missing = left_out(stated, result.gaussians.basis_names)
    if missing:
        watcher.say(left_out_sentence(missing))
    guard = Salvage(watcher.warn)
    about: dict[str, Any] = {"bases_left_out": list(missing)}
    about |= {} if choice is None else {"basis_choice": choice.record()}
    about["recipe"] = recipe.says if isinstance(recipe, PaperRecipe) else recipe.name
    truth: Truth | None = None
    with clock("score"):
        with guard("reading the truth"):
            truth = read_truth(dataset.path)
        metrics = metrics_of(dataset, truth, result, recipe.seed, guard) | about
        with guard("scoring the models along the way"):
            checkpoints.add_scores(_psnr_along_the_way(checkpoints, truth))
    first = {name: 0.0 for name in ("check", "basis") if name in clock.seconds}

    def write_metrics() -> None:
        costs = {"seconds": first | result.seconds | clock.seconds, "peak_memory_mib": peak_memory_mib()}
        metrics.update(costs, **({"failed": guard.failed} if guard.failed else {}))
        write_json(folder / "metrics.json", metrics)

    write_metrics()
    if figures:
        with clock("figures"):
            draw_model(dataset, truth, result.gaussians, folder / "figures", missing, guard)
            with guard("drawing convergence.png"):
                _draw_convergence(checkpoints.log, folder / "figures")
            if choice is not None:
                with guard("drawing edge.png"):
                    draw_choice(choice, dataset, folder / "figures" / "edge.png")
        write_metrics()
    return metrics


def chosen_recipe(name: str, sweeps: float | None, seed: int, held_out: int) -> Recipe:
    """The recipe with what a user chose; `sweeps` overrides the length of all stages, however few the views are."""
    recipe = replace(RECIPES[name], seed=seed, held_out=held_out)
    if sweeps is None:
        return recipe
    return replace(recipe, most_turns=1.0, stages=tuple(replace(stage, sweeps=sweeps) for stage in recipe.stages))


def _options(dataset: Dataset, recipe: Recipe | PaperRecipe) -> dict[str, Any]:
    """What results depend on beside the training views, by the names of options and of numbers of the recipe."""
    return {"grid": dataset.grid, **{f.name: getattr(recipe, f.name) for f in fields(recipe)}}


def write_model(dataset: Dataset, recipe: Recipe | PaperRecipe, result: Reconstruction, folder: Path) -> None:
    """Write the model, what it was fitted by, and what is known of the scan."""
    result.gaussians.save(folder / MODEL)
    (folder / "recipe.yaml").write_text(yaml.safe_dump(_plain(recipe), sort_keys=False), encoding="utf-8")
    write_scan(folder, dataset.grid, dataset.spectra.basis, result.transmission, dataset.spectra.channels)


def write_result(dataset: Dataset, result: Reconstruction, folder: Path) -> None:
    """Write the volumes of the model and those that it started from."""
    volumes = result.gaussians.volume(dataset.grid)
    others = {result.start: result.initial_volumes}
    write_volumes(folder / "volumes.h5", volumes, result.gaussians.basis_names, dataset.grid, others, result.unreliable)


def _stopped(progress: Progress, checkpoints: PartialRun, folder: Path) -> Stopped:
    """Write a checkpoint, if the fit can go on from one, and how far the model is."""
    if progress.state is not None:
        checkpoints.save(progress.state)
    done = {"gaussians": len(progress.gaussians), "step": progress.step, "steps": progress.steps}
    write_json(folder / "metrics.json", {"interrupted": done})
    return Stopped(f"after step {progress.step} of {progress.steps}")


def _check_test_views(dataset: Dataset) -> None:
    """Refuse counts that cannot be scored before the fit, not after it; one view at a time."""
    for view in dataset.splits["test"]:
        dataset.load([int(view)])


def metrics_of(
    dataset: Dataset, truth: Truth | None, result: Reconstruction, seed: int, guard: Guard = unguarded
) -> dict[str, Any]:
    """Scores of a fit and where it comes from, as ``metrics.json`` has them; without truth those of test views.

    What `guard` catches is left out.
    """
    gaussians = result.gaussians
    metrics: dict[str, Any] = {"dataset": dataset.path.name, "seed": seed, "gaussians": len(gaussians)}
    metrics["start"] = result.start
    if truth is not None:
        with guard("scoring against the truth"):
            metrics.update(score_truth(truth, gaussians, result.unreliable))
            metrics.update(
                score_start(result.start, truth, result.initial_volumes, gaussians.basis_names, dataset.grid)
            )
    metrics["channels"] = {}
    if len(dataset.splits["test"]):
        with guard("scoring the test views"):
            metrics["channels"] = score_test_views(dataset, gaussians, result.unreliable)
    if result.unreliable is not None:
        metrics["unreliable"] = result.unreliable.record()
    with guard("the verdict"):
        metrics["verdict"] = verdict.record(verdict_of_fit(dataset, result, metrics["channels"]))
    metrics["node_error"] = result.node_error
    metrics["notes"] = list(result.notes)
    metrics["versions"] = environment()
    return metrics


def verdict_of_fit(dataset: Dataset, result: Reconstruction, channels: dict[str, Any]) -> verdict.Verdict:
    """What a user should know; the bases that the dataset states are those of its file, whatever was chosen since."""
    with open_dataset(dataset.path, dataset.air) as stated:
        names = stated.spectra.basis.names
    volumes, views = result.gaussians.volume(dataset.grid), len(dataset.splits["train"])
    fitted, concedes = result.gaussians.basis_names, Recipe().dispersion
    return verdict.verdict_of(
        channels, concedes, result.coverage, volumes, views, fitted, names, result.notes, result.unreliable
    )


def _psnr_along_the_way(checkpoints: PartialRun, truth: Truth | None) -> dict[int, dict[str, float]]:
    """PSNR of each basis of the models along the way, by their step."""
    if truth is None:
        return {}
    models = ((step, Gaussians.load(path)) for step, path in checkpoints.snapshots().items())
    return {step: psnr_of_bases(truth, model) for step, model in models}


def _plain(recipe: Recipe | PaperRecipe) -> dict[str, Any]:
    """Recipe as plain lists and numbers."""
    return {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(recipe).items()}


def _draw_convergence(log: list[dict[str, Any]], folder: Path) -> None:
    """Draw how the fit went."""
    seconds, deviances = (np.array([entry[key] for entry in log]) for key in ("seconds", "deviance"))
    figures.convergence(seconds, deviances, folder / "convergence.png")
