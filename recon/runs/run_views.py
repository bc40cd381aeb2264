"""One whole run of a method that predicts views and has no volume: learn, score test views, write.

Basis volumes are absent, and so are their scores: None in ``metrics.json``, a dash in tables.
"""

import time
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
import yaml
from jaxtyping import Float

from phantomgen.dataset.layout import new_group
from phantomgen.dataset.reader import Dataset
from phantomgen.dataset.truth import read_truth
from phantomgen.runtime.guarded import Salvage
from phantomgen.runtime.plain_json import to_json, write_json
from phantomgen.runtime.stopwatch import Stopwatch, peak_memory_mib
from phantomgen.runtime.versions import environment
from recon.data.measurements import read_measurements
from recon.evaluation.metrics import HeldOutView, score_basis_volumes, score_projections
from recon.figures import run_figures as drawing
from recon.kedge.basis_names import Asked
from recon.voxel.image_domain import log_projections
from recon.voxel.method import Iteration, ViewMethod, ViewModel
from spectra.errors import InputError
from spectra.threads import without_other_pools

VIEWS = "views.h5"


@runtime_checkable
class Watcher(Protocol):
    """What is told how a run goes on."""

    def stage(self, name: str) -> None:
        """A stage begins."""

    def iterated(self, iteration: Iteration) -> None:
        """An iteration is done."""

    def say(self, sentence: str) -> None:
        """Something was decided."""

    def warn(self, sentence: str, error: Exception) -> None:
        """A score or a figure failed."""


@without_other_pools()
def run_views(
    dataset: Dataset,
    folder: Path,
    method: ViewMethod,
    bases: Asked,
    figures: bool,
    watcher: Watcher,
    clock: Stopwatch,
) -> dict[str, Any]:
    """Learn from the training views, score and write into `folder`; returns what ``metrics.json`` holds.

    Parameters
    ----------
    dataset : an open dataset
    folder : an existing folder with a subfolder ``figures``
    method : see `recon.voxel.method.ViewMethod`
    bases : None, as there are none
    figures : whether to draw
    watcher : is told about iterations
    clock : times stages; that of a check is over

    Raises
    ------
    InputError
        When bases are asked for.
    """
    if bases is not None:
        asked = bases if isinstance(bases, int) else ",".join(bases)
        raise InputError(f"the method {method.name} predicts views and has no basis volumes: leave --bases {asked} out")
    entries = []
    with clock("read"):
        measured = read_measurements(dataset, dataset.splits["train"]).completed()
        unseen = measured.unseen
        weights = np.broadcast_to(~unseen, measured.counts[:, 0].shape).astype(np.float32) if unseen.any() else None
        images = log_projections(measured)
    began = time.perf_counter()

    def on_iteration(iteration: Iteration) -> None:
        seconds = time.perf_counter() - began
        entries.append({"iteration": iteration.done, "seconds": seconds, "residual": iteration.residual})
        watcher.iterated(iteration)

    with clock(method.name):
        views = method.learn_views(images, weights, measured.geometry, dataset.grid, on_iteration)
    settings = {"method": method.name} | asdict(method)  # type: ignore[call-overload] - methods are dataclasses
    metrics: dict[str, Any] = {"dataset": dataset.path.name, "method": settings}
    with clock("write"):
        _write_views(folder / VIEWS, dataset, views)
        (folder / "recipe.yaml").write_text(yaml.safe_dump(settings, sort_keys=False), encoding="utf-8")
        (folder / "log.jsonl").write_text("".join(to_json(entry) + "\n" for entry in entries), encoding="utf-8")
    guard = Salvage(watcher.warn)
    with clock("score"):
        with guard("reading the truth"):
            metrics |= _no_volumes(dataset)
        metrics |= {"channels": {}, "versions": environment()}
        if len(dataset.splits["test"]):
            with guard("scoring the test views"):
                metrics["channels"] = score_projections(predicted_views(dataset, views), dataset.spectra.channels)

    def write_metrics() -> None:
        costs = {"seconds": clock.seconds, "peak_memory_mib": peak_memory_mib()}
        metrics.update(costs, **({"failed": guard.failed} if guard.failed else {}))
        write_json(folder / "metrics.json", metrics)

    write_metrics()
    if figures:
        with clock("figures"), guard("drawing residuals.png"):
            _draw(dataset, views, folder / "figures" / "residuals.png")
        write_metrics()
    return metrics


def predicted_views(dataset: Dataset, views: ViewModel) -> Iterator[HeldOutView]:
    """Test views of a dataset and what a model of log projections expects there, in order."""
    for view in dataset.splits["test"]:
        measured = read_measurements(dataset, np.array([view]))
        air = measured.gains * measured.open_beam * measured.exposure[0][:, None, None]
        expected = air * np.exp(-views(measured.geometry)[:, 0])
        yield HeldOutView.of(measured.counts[0], expected, air)


def _no_volumes(dataset: Dataset) -> dict[str, Any]:
    """Scores of basis volumes that are not there: None but for what a volume of zeros would score."""
    truth = read_truth(dataset.path)
    if truth is None:
        return {}
    zeros = score_basis_volumes(0 * truth.volumes, truth.volumes, truth.basis_names)
    absent = {
        name: {key: (value if key == "psnr_zero" else None) for key, value in s.items()} for name, s in zeros.items()
    }
    return {"basis": absent}


def _write_views(path: Path, dataset: Dataset, views: ViewModel) -> None:
    """Write ``/views/data``, the log projections that the model expects in the test views [no unit]."""
    import h5py  # noqa: PLC0415

    test = dataset.splits["test"]
    panel = dataset.geometry.panel
    images: Float[np.ndarray, "view channel row column"]
    images = np.zeros((0, len(dataset.spectra.channels), panel.rows, panel.columns), np.float32)
    if len(test):
        images = np.moveaxis(views(dataset.geometry[test]), 0, 1)
    with h5py.File(path, "w") as file:
        file.attrs.update({"NX_class": "NXroot", "default": "views", "creator": "recon"})
        group = new_group(file, "views", "NXdata", signal="data", axes=("view", "channel", "row", "column"))
        group.create_dataset("data", data=images, compression="gzip", compression_opts=1, shuffle=True)
        group.create_dataset("view", data=np.asarray(test))


def _draw(dataset: Dataset, views: ViewModel, path: Path) -> None:
    """Residuals of the first test view."""
    for view in predicted_views(dataset, views):
        taken = np.flatnonzero(view.open_beam.any(axis=(1, 2)))
        channels = [dataset.spectra.channels[c] for c in taken]
        drawing.residuals(view.counts[taken], view.expected[taken], channels, path, view.away)
        break
