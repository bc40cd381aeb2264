"""The steps of one run, which are the same for every method: check, reconstruct, write, score, draw."""

from pathlib import Path
from typing import Any

from phantomgen.dataset.reader import Dataset
from phantomgen.dataset.truth import read_truth
from phantomgen.runtime.guarded import WarnOnFailure
from phantomgen.runtime.plain_json import write_json
from phantomgen.runtime.stopwatch import Stopwatch, peak_memory_mib
from recon.kedge.basis_names import left_out_sentence
from recon.runs.interfaces import RunMethod, Watcher
from spectra.threads import without_other_pools


@without_other_pools()
def run(dataset: Dataset, folder: Path | None, method: RunMethod, figures: bool, watcher: Watcher) -> dict[str, Any]:
    """Reconstruct a dataset, write the result, score and draw it.

    Parameters
    ----------
    dataset : open dataset
    folder : existing folder with a subfolder ``figures``, which may hold an interrupted run; None where another process
        writes
    method : reconstructs; a `recon.runs.run_gaussians.GaussianRun`, `recon.runs.run_voxels.VoxelRun` or
        `recon.runs.run_views.ViewRun`
    figures : whether to draw
    watcher : shows stages, steps and decisions

    Returns
    -------
    what ``metrics.json`` holds; empty without a folder

    Raises
    ------
    Stopped
        When Ctrl-C ended a fit of Gaussians after a step; the model is in the folder.

    Notes
    -----
    The truth is opened only when the reconstruction is written. Scores or figures that fail after that are a warning,
    and are named under ``failed`` in ``metrics.json``.
    """
    clock, guard, truth = Stopwatch(watcher.stage), WarnOnFailure(watcher.warn), None
    with clock("check"):
        method.check(dataset)
        for view in dataset.splits["test"]:
            dataset.load([int(view)])  # counts that cannot be scored are refused now; one view is in memory at a time
    outcome = method.reconstruct(dataset, folder, clock, watcher)
    if folder is None:
        return {}
    with clock("write"):
        outcome.write(folder)
    if outcome.left_out:
        watcher.note(left_out_sentence(outcome.left_out))
    with clock("score"):
        with guard("reading the truth"):
            truth = read_truth(dataset.path)
        metrics = outcome.scores(truth, guard)
    _write_metrics(folder, metrics, clock, guard)
    if figures:
        with clock("figures"):
            outcome.draw(truth, folder / "figures", guard)
        _write_metrics(folder, metrics, clock, guard)
    return metrics


def _write_metrics(folder: Path, metrics: dict[str, Any], clock: Stopwatch, guard: WarnOnFailure) -> None:
    """Add times, memory and failures to the scores, and write them."""
    metrics |= {"seconds": clock.seconds, "peak_memory_mib": peak_memory_mib()}
    metrics |= {"failed": guard.failed} if guard.failed else {}
    write_json(folder / "metrics.json", metrics)
