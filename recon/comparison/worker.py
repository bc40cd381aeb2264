"""One contender in a process of its own: warm-up, timed runs, memory, and scores at the end.

The reconstruction reads only ``/entry`` of the dataset; the truth is opened after all runs. A command of a user gets
the whole file, and is a process of its own below this one.
"""

import os
import shutil
import sys
import threading
import time
from collections.abc import Sequence
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
from recon.comparison.contenders.other_program import Ended, OtherProgram, end_commands, run_command
from recon.comparison.contenders.recorder import RecordedModel, Recorder
from recon.comparison.contenders.timed_gaussians import run_gaussian, run_paper
from recon.comparison.contenders.timed_voxels import run_voxels
from recon.comparison.job import Job, write_result
from recon.comparison.scoring.scores import score
from recon.comparison.scoring.stated import psnr_of_attenuation, psnr_of_stated, score_attenuation, score_stated
from recon.evaluation.scoring import psnr_of_bases
from recon.evaluation.stated_volume import Statement, stated_volume
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
    if job.program is not None:
        _work_other(job, job.program)
        return
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
            model = runs.load(recorded_model.path)
            scored[recorded_model.path] = score(model, dataset, truth, pseudo)
            if job.stated and truth is not None and model.bases is not None:
                scored[recorded_model.path]["stated"] = score_attenuation(model.bases, job.stated, dataset, truth)
            scored[recorded_model.path]["stated_as"] = list(job.stated)
        count, kind = runs.load(recorded_model.path).primitives
        content |= {
            "seconds": recorded_model.seconds,
            "done": recorded_model.done,
            "total": recorded_model.total,
            "finished": recorder.is_final(recorded_model),
            "primitives": count,
            "kind": kind,
            "peak_memory_mib": memory,
            "curve": _curve(recorder.recorded, runs, truth, dataset, job.stated),
        }
        write_result(Path(job.folder), budget, content | scored[recorded_model.path])


def _work_other(job: Job, program: OtherProgram) -> None:
    """Run a command of a user for each budget, or take a finished volume, and score what it gives."""
    folder = Path(job.folder)
    if program.path is not None:
        write_result(folder, None, {"contender": job.contender, "budget": None} | _scored(job, program.path, None))
        return
    ended: Ended | None = None
    out = folder / f"volume{program.suffix}"
    for budget in sorted(job.budgets, reverse=not program.each_budget):
        content: dict[str, Any] = {"contender": job.contender, "budget": budget, "command": list(program.command)}
        if ended is None or program.each_budget:
            ended = run_command(program, Path(job.dataset), out, budget, job.clock, job.threads)
            found = {"error": ended.error} if ended.error else _scored(job, str(out), ended)
        if ended.too_short or ended.seconds > budget:
            found = {"error": f"nothing is ready within {budget:g} s: the command did not end", "too_short": True}
        write_result(folder, budget, content | found)


def _scored(job: Job, path: str, ended: Ended | None) -> dict[str, Any]:
    """Scores of a volume of another program, or the sentence that says why there are none."""
    assert job.program is not None
    with open_dataset(Path(job.dataset)) as dataset:
        truth = read_truth(dataset.path)
        try:
            found = stated_volume([path], Statement.of(job.program.statement, dataset.grid), dataset, truth)
            assert truth is not None
            pseudo = None if job.pseudo is None else np.load(job.pseudo)
            scores = score_stated(found, dataset, truth, pseudo)
            if found.complete:
                scores["stated"] = score_attenuation(found.model, job.stated, dataset, truth)
        except Error as error:
            return {"error": str(error)}
        level = psnr_of_stated(found)
        if found.complete:
            level |= psnr_of_attenuation(found.model, job.stated, dataset, truth)
    seconds = None if ended is None else ended.seconds
    curve = [] if ended is None or not level else [{"seconds": seconds, "done": 1.0} | level]
    about = {"seconds": seconds, "done": 1, "total": 1, "finished": True, "curve": curve, "level": level}
    size = {"primitives": int(np.prod(found.model.grid.shape)), "kind": "voxels"}
    memory = {"peak_memory_mib": None if ended is None else ended.memory, "statement": found.record}
    return about | size | memory | {"remarks": found.remarks()} | scores


def _curve(
    recorded: list[RecordedModel], runs: Runs, truth: Truth | None, dataset: Dataset, stated: Sequence[str]
) -> list[dict[str, float]]:
    """PSNR over time of each basis, and of attenuation that other programs state; empty without a truth.

    Entries are ``seconds``, ``done`` and ``psnr_<basis>`` [dB].
    """
    points = []
    if truth is None:
        return points
    for recorded_model in recorded:
        bases = runs.load(recorded_model.path).bases
        if bases is not None:
            scores = psnr_of_bases(truth, bases) | psnr_of_attenuation(bases, stated, dataset, truth)
            points.append({"seconds": recorded_model.seconds, "done": float(recorded_model.done)} | scores)
    return points


def end_with_parent() -> None:
    """End this process within a second after the end of the process that started it."""
    parent = os.getppid()

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(0.5)
        end_commands()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


if __name__ == "__main__":
    end_with_parent()
    work(Job.from_json(sys.stdin.read()))
