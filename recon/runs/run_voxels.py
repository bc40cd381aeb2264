"""One whole run of a classical method: reconstruct, score, write, as `recon.runs.run_gaussians` does for Gaussians.

Three ways lead from counts to volumes of the bases. `two-step`: every ray is decomposed by maximum likelihood, then the
line integrals of each basis are reconstructed. `image`: each channel is reconstructed, then decomposed in every voxel.
A method that takes counts knows a way of its own, and one that predicts views has no volume: `recon.runs.run_views`.
"""

import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from jaxtyping import Float

from phantomgen.dataset.reader import Dataset
from phantomgen.dataset.truth import Truth, read_truth
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.runtime.guarded import Guard, Salvage
from phantomgen.runtime.plain_json import to_json, write_json
from phantomgen.runtime.stopwatch import Stopwatch, peak_memory_mib
from phantomgen.runtime.versions import environment
from recon.data.coverage import coverage, inner_box
from recon.data.inpainting import inpainted
from recon.data.material_decomposition import decompose_views
from recon.data.measurements import Measurements, matching_bin, read_measurements
from recon.evaluation.scoring import psnr_of_bases, score_test_views, score_truth
from recon.evaluation.verdict import record, verdict_of
from recon.figures.model_figures import draw_model
from recon.gaussians.recipe import Recipe
from recon.kedge.basis_names import Asked, left_out, left_out_sentence, with_named
from recon.runs.run_folder import write_scan
from recon.runs.run_views import Watcher, run_views
from recon.runs.write_run import write_volumes
from recon.voxel.filtered.circular_orbit import circular_orbit_of
from recon.voxel.filtered.fdk import Fdk
from recon.voxel.image_domain import reconstruct_channels
from recon.voxel.initial_volumes import check_directions
from recon.voxel.margin import with_margin_found
from recon.voxel.method import CountsMethod, Iteration, Method, OnIteration, ViewMethod
from recon.voxel.model import Voxels
from recon.voxel.unreliable import Unreliable, unreliable_voxels
from spectra.errors import InputError
from spectra.threads import without_other_pools

PIPELINES = ("two-step", "image")
SNAPSHOTS = 10  # volumes kept along the way, for error against time


class _Log:
    """Residual of every iteration, and a few volumes along the way."""

    def __init__(self, grid: Grid) -> None:
        self._shape = grid.shape
        self.entries: list[dict[str, Any]] = []
        self.volumes: dict[int, np.ndarray] = {}
        self._began = time.perf_counter()

    def add(self, iteration: Iteration) -> None:
        seconds = time.perf_counter() - self._began
        self.entries.append({"iteration": iteration.done, "seconds": seconds, "residual": iteration.residual})
        last = self.entries[-2]["iteration"] if len(self.entries) > 1 else 0
        every = max(iteration.total // SNAPSHOTS, 1)
        due = iteration.done // every > last // every or iteration.done == iteration.total
        if due and iteration.volumes.shape[1:] == self._shape:
            self.volumes[iteration.done] = iteration.volumes.copy()

    def write(self, path: Path, truth: Truth | None, names: tuple[str, ...], grid: Grid) -> None:
        """One JSON object per iteration; those with kept volumes also have the PSNR of each basis."""
        for entry in self.entries:
            volumes = self.volumes.get(entry["iteration"])
            if volumes is not None and truth is not None:
                entry.update(psnr_of_bases(truth, Voxels(volumes, grid, names)))
        path.write_text("".join(to_json(entry) + "\n" for entry in self.entries), encoding="utf-8")


@without_other_pools()
def run_classical(
    dataset: Dataset,
    folder: Path,
    method: Method | ViewMethod,
    pipeline: str,
    bases: Asked,
    figures: bool,
    watcher: Watcher,
) -> dict[str, Any]:
    """Reconstruct, score and write everything into `folder`; returns what ``metrics.json`` holds.

    Parameters
    ----------
    dataset : an open dataset
    folder : an existing folder with a subfolder ``figures``
    method : see `recon.runs.methods`
    pipeline : one of `PIPELINES`
    bases : how many of the dataset's basis functions to use, or their names; default all
    figures : whether to draw
    watcher : is told about stages and iterations
    """
    clock, log = Stopwatch(watcher.stage), _Log(dataset.grid)
    with clock("check"):
        check_method(method, pipeline, dataset)
        for view in dataset.splits["test"]:
            dataset.load([int(view)])  # counts that cannot be scored are refused now
    if isinstance(method, ViewMethod):
        return run_views(dataset, folder, method, bases, figures, watcher, clock)
    stated = dataset.spectra.basis.names
    dataset, count = with_named(dataset, bases)
    with clock("read"):
        measured = read_measurements(dataset, dataset.splits["train"], count)
        covered = coverage(measured, dataset.grid)
        measured, node_error = measured.without_partial_volume().compressed(Recipe().node_tolerance)
        covered = with_margin_found(measured, covered) if isinstance(method, CountsMethod) else covered
    grid = covered.grid if isinstance(method, CountsMethod) else dataset.grid

    def on_iteration(iteration: Iteration) -> None:
        log.add(iteration)
        watcher.iterated(iteration)

    volumes = reconstruct_volumes(measured, grid, method, pipeline, clock, on_iteration)
    with_margin = Voxels(volumes, grid, measured.basis_names)  # it takes part in views, and is not written
    volumes = np.ascontiguousarray(volumes[:, *inner_box(dataset.grid, grid)])
    model = Voxels(volumes, dataset.grid, measured.basis_names)
    with clock("mark"):
        unreliable = unreliable_voxels(volumes, measured, dataset.grid, Recipe().dispersion)
    with clock("write"):
        write_volumes(folder / "volumes.h5", volumes, model.basis_names, model.grid, {}, unreliable)
        spectra = dataset.spectra
        write_scan(folder, model.grid, spectra.basis, measured.transmission, spectra.channels)
        recipe = yaml.safe_dump(_settings(method, pipeline), sort_keys=False)
        (folder / "recipe.yaml").write_text(recipe, encoding="utf-8")
        log.write(folder / "log.jsonl", None, model.basis_names, model.grid)
    missing = left_out(stated, model.basis_names)
    if missing:
        watcher.say(left_out_sentence(missing))
    guard, truth = Salvage(watcher.warn), None
    with clock("score"):
        with guard("reading the truth"):
            truth = read_truth(dataset.path)
        metrics = _metrics(dataset, truth, model, with_margin, unreliable, method, pipeline, guard)
        metrics |= {"node_error": node_error, "bases_left_out": list(missing)}
        with guard("the verdict"):
            views, concedes = len(dataset.splits["train"]), Recipe().dispersion
            said = verdict_of(
                metrics["channels"], concedes, covered, volumes, views, model.basis_names, stated, (), unreliable
            )
            metrics["verdict"] = record(said)
        with guard("scoring the volumes along the way"):
            log.write(folder / "log.jsonl", truth, model.basis_names, model.grid)

    def write_metrics() -> None:
        costs = {"seconds": clock.seconds, "peak_memory_mib": peak_memory_mib()}
        metrics.update(costs, **({"failed": guard.failed} if guard.failed else {}))
        write_json(folder / "metrics.json", metrics)

    write_metrics()
    if figures:
        with clock("figures"):
            draw_model(dataset, truth, model, folder / "figures", missing, guard)
        write_metrics()
    return metrics


def check_method(method: Method | ViewMethod, pipeline: str, dataset: Dataset) -> None:
    """Refuse what cannot be, before any work.

    Raises
    ------
    InputError
        When a method has no such pipeline.
    GeometryError
        When the scan shows no depth, or has another orbit than filtered back-projection needs.
    """
    if isinstance(method, CountsMethod) and pipeline != PIPELINES[0]:
        raise InputError(f"the method {method.name} works on counts: leave --pipeline {pipeline} out")
    if isinstance(method, ViewMethod) and pipeline != PIPELINES[0]:
        raise InputError(f"the method {method.name} has no volume: leave --pipeline {pipeline} out")
    train = dataset.geometry[dataset.splits["train"]]
    check_directions(train)
    if isinstance(method, Fdk):
        circular_orbit_of(train, dataset.grid)


def reconstruct_volumes(
    measured: Measurements,
    grid: Grid,
    method: Method,
    pipeline: str,
    stage: Stopwatch,
    on_iteration: OnIteration,
) -> Float[np.ndarray, "basis z y x"]:
    """Volumes of the bases [1/mm] from counts."""
    if isinstance(method, CountsMethod):
        with stage(method.name):
            return method.reconstruct_counts(measured, grid, on_iteration)
    coarse = measured.completed().binned(matching_bin(measured.geometry, min(grid.spacing)))
    unseen = coarse.unseen
    seen = np.broadcast_to(~unseen, coarse.counts[:, 0].shape).astype(np.float32) if unseen.any() else None
    if pipeline == "image":
        with stage(method.name):
            return reconstruct_channels(coarse, seen, method, grid, on_iteration)
    with stage("decompose"):
        lengths = inpainted(decompose_views(coarse, Recipe().dispersion)[0], unseen)
    with stage(method.name):
        images = np.ascontiguousarray(np.moveaxis(lengths, 1, 0))
        return method.reconstruct(images, seen, coarse.geometry, grid, on_iteration)


def _settings(method: Method, pipeline: str) -> dict[str, Any]:
    """Name of a method and what steers it, as plain numbers."""
    way = {} if isinstance(method, CountsMethod) else {"pipeline": pipeline}
    return {"method": method.name} | way | asdict(method)  # type: ignore[call-overload] - methods are dataclasses


def _metrics(
    dataset: Dataset,
    truth: Truth | None,
    model: Voxels,
    with_margin: Voxels,
    unreliable: Unreliable | None,
    method: Method,
    pipeline: str,
    guard: Guard,
) -> dict[str, Any]:
    metrics: dict[str, Any] = {"dataset": dataset.path.name, "method": _settings(method, pipeline)}
    if truth is not None:
        with guard("scoring against the truth"):
            metrics.update(score_truth(truth, model, unreliable))
    metrics["channels"] = {}
    if len(dataset.splits["test"]):
        with guard("scoring the test views"):
            metrics["channels"] = score_test_views(dataset, with_margin, unreliable)
    if unreliable is not None:
        metrics["unreliable"] = unreliable.record()
    metrics["versions"] = environment()
    return metrics
