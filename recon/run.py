"""One whole run: reconstruct, score, write. The truth is opened only when the fit is over."""

import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import yaml

from phantomgen.dataset import Dataset
from phantomgen.dataset_truth import Truth, read_truth
from phantomgen.stopwatch import Stopwatch, peak_memory_mib
from phantomgen.versions import environment
from recon import figures
from recon.fitting import Progress
from recon.gaussians import Gaussians
from recon.metrics import psnr
from recon.orbit_check import check_full_circle
from recon.paper.pipeline import reconstruct_paper
from recon.paper.recipe import PaperRecipe
from recon.pipeline import Reconstruction, reconstruct
from recon.recipe import Recipe
from recon.report import MODEL, write_json, write_volumes
from recon.scoring import held_out_views, score_start, score_test_views, score_truth
from spectra.threads import without_other_pools

SNAPSHOTS = 10  # models kept along the way, for error against time


class Watcher(Protocol):
    """What is told how a run goes on."""

    def stage(self, name: str) -> None:
        """A stage begins."""

    def step(self, progress: Progress) -> None:
        """A step of the fit is done."""


class _Log:
    """Deviance of every step, and a few models along the way."""

    def __init__(self) -> None:
        self.steps: list[dict[str, float]] = []
        self.models: dict[int, Gaussians] = {}

    def add(self, progress: Progress) -> None:
        self.steps.append({"step": progress.step, "seconds": progress.seconds, "deviance": progress.deviance})
        if progress.step % max(progress.steps // SNAPSHOTS, 1) == 0 or progress.step == progress.steps:
            self.models[progress.step] = progress.gaussians.detached()

    def write(self, path: Path, truth: Truth | None) -> None:
        """One JSON object per step; steps with a kept model also have the PSNR of each basis."""
        for entry in self.steps:
            model = self.models.get(int(entry["step"]))
            if model is not None and truth is not None and model.basis_names == truth.basis_names:
                entry.update(_psnr_of_bases(model, truth))
        path.write_text("".join(json.dumps(entry) + "\n" for entry in self.steps), encoding="utf-8")


@without_other_pools()
def run(
    dataset: Dataset,
    folder: Path,
    bases: int | None,
    sweeps: float | None,
    seed: int,
    figures: bool,
    watcher: Watcher,
    paper: PaperRecipe | None = None,
) -> dict[str, Any]:
    """Reconstruct, score and write everything into `folder`; returns what ``metrics.json`` holds.

    Parameters
    ----------
    dataset : an open dataset
    folder : an existing folder with a subfolder ``figures``
    bases : how many of the dataset's basis functions to fit, default all
    sweeps : overrides the length of the recipe's stages
    seed : of the first Gaussians
    figures : whether to draw
    watcher : is told about stages and steps
    paper : run the paper's method by this recipe instead
    """
    recipe = Recipe(seed=seed)
    if sweeps is not None:
        recipe = replace(recipe, stages=tuple(replace(stage, sweeps=sweeps) for stage in recipe.stages))
    log, clock = _Log(), Stopwatch(watcher.stage)
    with clock("check"):
        check_full_circle(dataset.geometry[dataset.splits["train"]])
        _check_test_views(dataset)

    def on_step(progress: Progress) -> None:
        log.add(progress)
        watcher.step(progress)

    if paper is None:
        result = reconstruct(dataset, recipe, bases, watcher.stage, on_step)
    else:
        result = reconstruct_paper(dataset, paper, bases, watcher.stage, on_step)
    with clock("score"):
        truth = read_truth(dataset.path)
        metrics = _metrics(dataset, truth, result, seed)
        metrics["recipe"] = "fast" if paper is None else paper.says
    with clock("write"):
        grid = dataset.grid
        volumes = result.gaussians.volume(grid)
        result.gaussians.save(folder / MODEL)
        write_volumes(folder / "volumes.h5", volumes, result.gaussians.basis_names, grid, result.fdk_volumes)
        (folder / "recipe.yaml").write_text(yaml.safe_dump(_plain(paper or recipe), sort_keys=False), encoding="utf-8")
        log.write(folder / "log.jsonl", truth)
    if figures:
        with clock("figures"):
            _draw(dataset, truth, result, log, folder / "figures")
    metrics["seconds"] = {"check": 0.0, **result.seconds, **clock.seconds}
    metrics["peak_memory_mib"] = peak_memory_mib()
    write_json(folder / "metrics.json", metrics)
    return metrics


def _check_test_views(dataset: Dataset) -> None:
    """Refuse counts that cannot be scored before the fit, not after it; one view at a time."""
    for view in dataset.splits["test"]:
        dataset.load([view])


def _metrics(dataset: Dataset, truth: Truth | None, result: Reconstruction, seed: int) -> dict[str, Any]:
    gaussians = result.gaussians
    metrics: dict[str, Any] = {"dataset": dataset.path.name, "seed": seed, "gaussians": len(gaussians)}
    if truth is not None:
        metrics.update(score_truth(truth, gaussians))
        metrics.update(score_start(truth, result.fdk_volumes, gaussians.basis_names, dataset.grid))
    metrics["channels"] = score_test_views(dataset, gaussians) if len(dataset.splits["test"]) else {}
    metrics["node_error"] = result.node_error
    metrics["versions"] = environment()
    return metrics


def _psnr_of_bases(model: Gaussians, truth: Truth) -> dict[str, float]:
    volumes = model.volume(truth.grid)
    scores = {}
    for name, volume, true in zip(truth.basis_names, volumes, truth.volumes, strict=True):
        value = psnr(float(true.max()), float(np.mean((volume - true) ** 2)))
        if value is not None:
            scores[f"psnr_{name}"] = value
    return scores


def _plain(recipe: Recipe | PaperRecipe) -> dict[str, Any]:
    """Recipe as plain lists and numbers."""
    return {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(recipe).items()}


def _draw(dataset: Dataset, truth: Truth | None, result: Reconstruction, log: _Log, folder: Path) -> None:
    """Draw every figure that the data allow."""
    gaussians, grid = result.gaussians, dataset.grid if truth is None else truth.grid
    names, volumes = gaussians.basis_names, gaussians.volume(grid)
    true = truth.volumes if truth is not None and truth.basis_names == names else None
    for plane in ("axial", "coronal"):
        figures.basis_slices(volumes, true, names, grid, folder / f"{plane}.png", plane)
    figures.profiles(volumes, true, names, grid, folder / "profiles.png")
    seconds, deviances = (np.array([entry[key] for entry in log.steps]) for key in ("seconds", "deviance"))
    figures.convergence(seconds, deviances, folder / "convergence.png")
    s = dataset.spectra
    figures.spectrum(
        s.energy, s.edges, s.source, s.response, s.channels, s.basis.names, s.basis_values, folder / "spectrum.png",
        s.basis.breaks,
    )  # fmt: skip
    for view in held_out_views(dataset, gaussians):
        taken = np.flatnonzero(view.open_beam.any(axis=(1, 2)))
        names = [s.channels[c] for c in taken]
        figures.residuals(view.counts[taken], view.expected[taken], names, folder / "residuals.png", view.away)
        break
