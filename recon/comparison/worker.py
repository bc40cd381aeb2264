"""One contender in a process of its own: warm-up, timed runs, memory, and scores at the end.

The reconstruction reads only ``/entry`` of the dataset; the truth is opened after all runs.
"""

import os
import shutil
import sys
import threading
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from phantomgen.dataset.reader import Dataset, open_dataset
from phantomgen.dataset.truth import Truth, read_truth
from phantomgen.runtime.stopwatch import peak_memory_mib
from recon.comparison.contenders.clock import Clock
from recon.comparison.contenders.contender import GAUSSIAN, PAPER, Contender, contender
from recon.comparison.contenders.model import Runs
from recon.comparison.contenders.recorder import RecordedModel, Recorder
from recon.comparison.contenders.timed_gaussians import run_gaussian, run_paper
from recon.comparison.contenders.timed_voxels import run_voxels
from recon.comparison.job import Job, write_result
from recon.comparison.scoring.scores import score
from recon.evaluation.scoring import psnr_of_bases
from recon.voxel.iterative.multigrid import coarser
from spectra.errors import Error
from spectra.threads import set_threads, without_other_pools

WARM_VIEWS, WARM_VOXELS = 12, 16  # views, and voxels along an axis, of the small problem on which kernels are compiled


def work(job: Job) -> None:
    """Run and score a contender; the message of a method that refuses takes the place of scores.

    Parameters
    ----------
    job : contender and budgets
    """
    set_threads(job.threads)
    folder, who = Path(job.folder), contender(job.contender)
    room = folder / "models"
    with open_dataset(Path(job.dataset)) as dataset:
        try:
            seen = restricted(dataset, who)
            with suppress(Error):
                run(_small(seen), who, replace(job, budgets=(0.0,)), room)
            runs = run(seen, who, job, room)
            _write_scores(job, dataset, runs, peak_memory_mib())
        except Error as error:
            for budget in job.budgets:
                write_result(folder, budget, {"contender": job.contender, "budget": budget, "error": str(error)})
        finally:
            shutil.rmtree(room, ignore_errors=True)


def restricted(dataset: Dataset, who: Contender) -> Dataset:
    """Restrict a dataset to what a contender may use: some of the training views, and all channels but one.

    Parameters
    ----------
    dataset : open dataset
    who : contender

    Returns
    -------
    the same open file
    """
    if who.views is not None:
        dataset = dataset.with_training_views(who.views)
    return dataset if who.blind is None else dataset.without_channel(who.blind)


@without_other_pools()
def run(dataset: Dataset, who: Contender, job: Job, room: Path) -> Runs:
    """Run a contender as often as the budgets of a job need.

    Parameters
    ----------
    dataset : open dataset, restricted to what the contender may use
    who : contender
    job : its budgets and clock
    room : folder for models, which is replaced

    Returns
    -------
    the runs with their models
    """
    shutil.rmtree(room, ignore_errors=True)
    clock, made = Clock(job.clock), []

    def new(budgets: list[float]) -> Recorder:
        place = room / str(len(made))
        place.mkdir(parents=True)
        made.append(Recorder(clock, place, budgets))
        return made[-1]

    budgets = sorted(job.budgets)
    if who.method == GAUSSIAN:
        return run_gaussian(dataset, who, clock, new, budgets)
    if who.method == PAPER:
        return run_paper(dataset, who, clock, new, budgets)
    return run_voxels(dataset, who, new(budgets))


def _small(dataset: Dataset) -> Dataset:
    """Few views and large voxels of a scan; the number of views divides theirs, so that they stay evenly spaced."""
    views = len(dataset.splits["train"])
    few = min((n for n in range(1, views + 1) if views % n == 0), key=lambda n: abs(n - WARM_VIEWS))
    factor = max(max(dataset.grid.shape) // WARM_VOXELS, 1)
    return dataset.with_training_views(few).with_grid(coarser(dataset.grid, factor))


def _write_scores(job: Job, dataset: Dataset, runs: Runs, memory: float | None) -> None:
    """Score the result for each budget, and the models between the steps."""
    truth = read_truth(dataset.path)
    pseudo = None if job.pseudo is None else np.load(job.pseudo)
    scored: dict[Path, dict[str, Any]] = {}
    for budget in job.budgets:
        recorder = runs.recorder(budget)
        recorded_model = None if recorder is None else recorder.result(budget)
        content: dict[str, Any] = {"contender": job.contender, "budget": budget}
        if recorder is None or recorded_model is None:
            lacking = f"nothing is ready within {budget:g} s: {runs.lacking}"
            write_result(Path(job.folder), budget, content | {"error": lacking, "too_short": True})
            continue
        if recorded_model.path not in scored:
            scored[recorded_model.path] = score(runs.load(recorded_model.path), dataset, truth, pseudo)
        count, kind = runs.load(recorded_model.path).primitives
        content |= {
            "seconds": recorded_model.seconds,
            "done": recorded_model.done,
            "total": recorded_model.total,
            "finished": recorder.is_final(recorded_model),
            "primitives": count,
            "kind": kind,
            "peak_memory_mib": memory,
            "curve": _curve(recorder.recorded, runs, truth),
        }
        write_result(Path(job.folder), budget, content | scored[recorded_model.path])


def _curve(recorded: list[RecordedModel], runs: Runs, truth: Truth | None) -> list[dict[str, float]]:
    """PSNR of each basis over time, as ``seconds``, ``done`` and ``psnr_<basis>`` [dB]; empty without a truth."""
    points = []
    if truth is None:
        return points
    for recorded_model in recorded:
        bases = runs.load(recorded_model.path).bases
        if bases is not None:
            points.append(
                {"seconds": recorded_model.seconds, "done": float(recorded_model.done)} | psnr_of_bases(truth, bases)
            )
    return points


def end_with_parent() -> None:
    """End this process within a second after the end of the process that started it."""
    parent = os.getppid()

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(0.5)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


if __name__ == "__main__":
    end_with_parent()
    work(Job.from_json(sys.stdin.read()))
