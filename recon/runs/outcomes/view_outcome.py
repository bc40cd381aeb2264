"""A finished model of views without volumes: its files, scores and figure.

Basis volumes are absent, and so are their scores: None in ``metrics.json``, a dash in tables.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from jaxtyping import Float

from phantomgen.dataset.layout import new_group
from phantomgen.dataset.reader import Dataset
from phantomgen.dataset.truth import Truth
from phantomgen.runtime.guarded import Guard
from phantomgen.runtime.versions import environment
from recon.data.measurements import read_measurements
from recon.evaluation.count_noise import CountNoise
from recon.evaluation.metrics import HeldOutView, score_basis_volumes, score_projections
from recon.figures import run_figures as drawing
from recon.runs.run_folder import VIEWS
from recon.voxel.method import ViewModel


@dataclass(frozen=True, eq=False)
class ViewOutcome:
    """A finished model of views; a `recon.runs.interfaces.Outcome`.

    Parameters
    ----------
    dataset : open dataset
    views : predicts log projections
    settings : of the method, content of ``recipe.yaml``
    left_out : empty, as there are no basis functions
    """

    dataset: Dataset
    views: ViewModel
    settings: dict[str, Any]
    left_out: tuple[str, ...] = ()

    def write(self, folder: Path) -> None:
        """Write ``/views/data``, the log projections of the test views [no unit], and the settings.

        Parameters
        ----------
        folder : run folder
        """
        from phantomgen.runtime.hdf5_output import hdf5_output  # noqa: PLC0415 - h5py

        (folder / "recipe.yaml").write_text(yaml.safe_dump(self.settings, sort_keys=False), encoding="utf-8")
        test, panel = self.dataset.splits["test"], self.dataset.geometry.panel
        images: Float[np.ndarray, "view channel row column"]
        images = np.zeros((0, len(self.dataset.spectra.channels), panel.rows, panel.columns), np.float32)
        if len(test):
            images = np.moveaxis(self.views(self.dataset.geometry[test]), 0, 1)
        with hdf5_output(folder / VIEWS) as file:
            file.attrs.update({"NX_class": "NXroot", "default": "views", "creator": "recon"})
            group = new_group(file, "views", "NXdata", signal="data", axes=("view", "channel", "row", "column"))
            group.create_dataset(
                "data", data=images, compression="gzip", compression_opts=1, shuffle=True, fletcher32=True
            )
            group.create_dataset("view", data=np.asarray(test))

    def scores(self, truth: Truth | None, guard: Guard) -> dict[str, Any]:
        """Compute what ``metrics.json`` holds beside times and memory.

        Parameters
        ----------
        truth : of the dataset; None where it has none
        guard : of each score; what it catches is left out

        Returns
        -------
        entries of ``metrics.json``; scores of basis volumes are None but for that of a volume of zeros
        """
        metrics: dict[str, Any] = {"dataset": self.dataset.path.name, "method": self.settings, "channels": {}}
        if truth is not None:
            zeros = score_basis_volumes(0 * truth.volumes, truth.volumes, truth.basis_names)
            metrics["basis"] = {
                name: {key: (value if key == "psnr_zero" else None) for key, value in scores.items()}
                for name, scores in zeros.items()
            }
        if len(self.dataset.splits["test"]):
            with guard("scoring the test views"):
                views = predicted_views(self.dataset, self.views)
                metrics["channels"] = score_projections(views, self.dataset.spectra.channels)
        return metrics | {"versions": environment()}

    def draw(self, truth: Truth | None, folder: Path, guard: Guard) -> None:
        """Draw the residuals of the first test view.

        Parameters
        ----------
        truth : not used, as there are no volumes
        folder : of the figures
        guard : of the figure; what it catches is left out
        """
        del truth
        with guard("drawing residuals.png"):
            for view in predicted_views(self.dataset, self.views):
                taken = np.flatnonzero(view.open_beam.any(axis=(1, 2)))
                channels = [self.dataset.spectra.channels[c] for c in taken]
                path = folder / "residuals.png"
                drawing.residuals(view.counts[taken], view.expected[taken], channels, path, view.away)
                break


def predicted_views(dataset: Dataset, views: ViewModel) -> Iterator[HeldOutView]:
    """Yield the test views of a dataset beside their prediction, in order.

    Parameters
    ----------
    dataset : open dataset
    views : predicts log projections of all channels

    Yields
    ------
    measured and predicted counts of a view
    """
    noise = CountNoise.of(dataset)
    for view in dataset.splits["test"]:
        measured = read_measurements(dataset, np.array([view]))
        air = measured.gains * measured.open_beam * measured.exposure[0][:, None, None]
        expected = air * np.exp(-views(measured.geometry)[:, 0])
        yield HeldOutView.of(measured.counts[0], expected, air, spread=noise.spread(expected))
