"""A finished reconstruction with volumes, in Gaussians or in voxels: its files, scores and figures."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
import torch
import yaml
from jaxtyping import Bool, Float

from phantomgen.dataset.reader import Dataset
from phantomgen.dataset.truth import Truth
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.runtime.guarded import Guard
from phantomgen.runtime.versions import environment
from recon.data.coverage import Coverage, seen_by_all_views
from recon.data.volume_edges import occupied_voxels
from recon.evaluation import verdict
from recon.evaluation.scoring import (
    psnr_of_bases,
    score_fitted_views,
    score_start,
    score_test_views,
    score_truth,
)
from recon.figures.model_figures import draw_model
from recon.gaussians.model import GaussianModel
from recon.gaussians.recipe import Recipe
from recon.runs.run_folder import MODEL, VOLUMES, write_scan
from recon.runs.write_run import write_volumes
from recon.voxel.model import Voxels
from recon.voxel.unreliable import Unreliable
from spectra.transmission import Transmission


@runtime_checkable
class Log(Protocol):
    """Interface of a log that kept models between its steps, as `recon.runs.unfinished_run.PartialRun` does."""

    def models(self) -> Iterator[tuple[int, GaussianModel | Voxels]]:
        """Yield the models that were kept.

        Yields
        ------
        number of the step, and its model
        """
        ...

    def add_scores(self, scores: dict[int, dict[str, float]]) -> None:
        """Add scores to the entries of their steps.

        Parameters
        ----------
        scores : by number of the step, such as ``psnr_compton`` [dB]
        """


@dataclass(frozen=True, eq=False)
class VolumeOutcome:
    """A finished reconstruction with volumes.

    Parameters
    ----------
    dataset : open dataset, in the basis functions from which those of the model were chosen
    model : the result
    transmission : spectral model of the reconstruction
    about : first entries of ``metrics.json``: dataset, method and what was chosen
    settings : content of ``recipe.yaml``
    node_error : largest error of the log counts from compressing the energy grid
    in_views : the result as test views are predicted from it, with the margin of a truncated scan; None for `model`
    coverage : what the scan covers of its object; None for a method that does not compute it
    unreliable : voxels whose bases the counts do not determine; None where there are none
    left_out : names of the dataset's basis functions that were not reconstructed
    notes : sentences of the reconstruction for the verdict
    start : volumes that the reconstruction began with [1/mm], by the name of their method
    log : models that were kept between the steps; None for no scores of them
    computed : volumes of the model on the grid of the dataset [1/mm]; None to compute them where they are needed
    figures : functions that draw more than `recon.figures.model_figures.draw_model`, by the name of the file
    """

    dataset: Dataset
    model: GaussianModel | Voxels
    transmission: Transmission
    about: dict[str, Any]
    settings: dict[str, Any]
    node_error: float = 0.0
    in_views: Voxels | None = None
    coverage: Coverage | None = None
    unreliable: Unreliable | None = None
    left_out: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    start: Mapping[str, Float[np.ndarray, "basis z y x"]] = field(default_factory=dict)
    log: Log | None = None
    computed: Float[np.ndarray, "basis z y x"] | None = None
    figures: Mapping[str, Callable[[Path], Any]] = field(default_factory=dict)

    @cached_property
    def volumes(self) -> Float[np.ndarray, "basis z y x"]:
        """The result on the grid of the dataset [1/mm]."""
        return self.model.volume(self.dataset.grid) if self.computed is None else self.computed

    def _volumes_on(self, grid: Grid) -> GaussianModel | Voxels:
        """The volumes, where they are on this grid; else the model, whose volumes take seconds."""
        known = grid == self.dataset.grid
        return Voxels(self.volumes, grid, self.model.basis_names) if known else self.model

    @property
    def _occupied(self) -> int:
        """Number of voxels that are not air."""
        return int(occupied_voxels(self.volumes).sum())

    def write(self, folder: Path) -> None:
        """Write model, settings, the record of the scan, and volumes.

        Parameters
        ----------
        folder : run folder
        """
        self.write_model(folder)
        grid, names = self.dataset.grid, self.model.basis_names
        write_volumes(folder / VOLUMES, self.volumes, names, grid, dict(self.start), self.unreliable)

    def write_model(self, folder: Path) -> None:
        """Write Gaussians, where the result has them, settings, and the record of the scan.

        Parameters
        ----------
        folder : run folder
        """
        if isinstance(self.model, GaussianModel):
            self.model.save(folder / MODEL)
        (folder / "recipe.yaml").write_text(yaml.safe_dump(self.settings, sort_keys=False), encoding="utf-8")
        spectra = self.dataset.spectra
        write_scan(folder, self.dataset.grid, spectra.basis, self.transmission, spectra.channels)

    def scores(self, truth: Truth | None, guard: Guard) -> dict[str, Any]:
        """Compute what ``metrics.json`` holds beside times and memory.

        Parameters
        ----------
        truth : of the dataset; None where it has none
        guard : of each score; what it catches is left out

        Returns
        -------
        entries of ``metrics.json``
        """
        metrics, names = dict(self.about), self.model.basis_names
        if isinstance(self.model, GaussianModel):
            metrics["numbers"] = self.model.numbers
            metrics["numbers_over_voxels"] = self.model.numbers / max(self._occupied * len(names), 1)
        if truth is not None:
            with guard("scoring against the truth"):
                metrics.update(score_truth(truth, self._volumes_on(truth.grid), self._doubtful(truth.grid)))
                for method, volumes in self.start.items():
                    metrics.update(score_start(method, truth, volumes, names, self.dataset.grid))
        metrics["channels"] = {}
        if len(self.dataset.splits["test"]):
            with guard("scoring the test views"):
                metrics["channels"] = self.score_test_views()
        if self.unreliable is not None:
            metrics["unreliable"] = self.unreliable.record()
        with guard("the verdict"):
            metrics["verdict"] = verdict.record(self.verdict(metrics["channels"]))
        if self.log is not None:
            with guard("scoring the models between the steps"):
                self.log.add_scores({} if truth is None else self._scores_between(truth, self.log))
        about = {"node_error": self.node_error, "bases_left_out": list(self.left_out), "versions": environment()}
        return metrics | about

    def _doubtful(self, grid: Grid) -> Bool[np.ndarray, "z y x"] | None:
        """Voxels that are marked, or that the panel cuts off in some views; None where there are none."""
        marked = np.zeros(grid.shape, dtype=bool)
        if self.unreliable is not None and self.unreliable.grid == grid:
            marked |= self.unreliable.marked
        if self.coverage is not None and self.coverage.truncated:
            seen = seen_by_all_views(self.dataset.geometry[self.dataset.splits["train"]], grid)
            marked |= ~seen if seen.any() else False  # of a helix, each view sees a part
        return marked if marked.any() else None

    def _scores_between(self, truth: Truth, log: Log) -> dict[int, dict[str, float]]:
        """Score the models that were kept; of the last one, which is the result in most fits, volumes are known."""
        known = self._volumes_on(truth.grid)
        return {step: psnr_of_bases(truth, known if self._is_result(model) else model) for step, model in log.models()}

    def _is_result(self, model: GaussianModel | Voxels) -> bool:
        """Whether a model holds the same numbers as the result."""
        if isinstance(model, Voxels) or isinstance(self.model, Voxels):
            return model is self.model
        one, other = model.tensors(), self.model.tensors()
        return one.keys() == other.keys() and all(torch.equal(one[name], other[name]) for name in one)

    def score_test_views(self) -> dict[str, Any]:
        """Score the prediction of the test views.

        Returns
        -------
        by channel, see `recon.evaluation.metrics.score_projections`; empty without test views
        """
        if not len(self.dataset.splits["test"]):
            return {}
        return score_test_views(self.dataset, self.in_views or self.model, self.unreliable)

    def verdict(self, channels: Mapping[str, Any]) -> verdict.Verdict:
        """Judge the result without the truth.

        Parameters
        ----------
        channels : of `score_test_views`

        Returns
        -------
        remarks, see `recon.evaluation.verdict`
        """
        fitted, views = self.model.basis_names, len(self.dataset.splits["train"])
        stated = (*fitted, *self.left_out)
        known = {}
        if not len(self.dataset.splits["test"]):
            known = score_fitted_views(self.dataset, self.in_views or self.model, self.unreliable)
        outcome = verdict.FitOutcome(
            channels,
            Recipe().dispersion,
            self.volumes,
            views,
            fitted,
            stated,
            self.coverage,
            self.unreliable,
            self.notes,
            known,
        )
        return verdict.verdict_of(outcome)

    def draw(self, truth: Truth | None, folder: Path, guard: Guard) -> None:
        """Draw all figures.

        Parameters
        ----------
        truth : of the dataset; None where it has none
        folder : of the figures
        guard : of each figure; what it catches is left out
        """
        grid = self.dataset.grid if truth is None else truth.grid
        draw_model(self.dataset, truth, self.model, folder, self.left_out, guard, self._volumes_on(grid))
        for name, draw in self.figures.items():
            with guard(f"drawing {name}"):
                draw(folder / name)
