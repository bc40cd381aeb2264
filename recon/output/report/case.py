"""What a report is made from: runs, and as far as they are at hand the scan that they reconstruct and its truth."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Integer

from phantomgen.dataset.reader import Dataset
from phantomgen.dataset.truth import Truth
from phantomgen.display.figures.style import BASIS_LINES, RESULT
from phantomgen.display.html import Part
from phantomgen.geometry.voxel_grid import Grid
from recon.output.report.finished_run import FinishedRun
from spectra.errors import InputError

Parts = tuple[Part, ...]
LINES = ((RESULT, "-"), *BASIS_LINES)  # of runs: colours and dashes


class LeftOut(Exception):  # noqa: N818 - nothing is wrong
    """A section that these runs cannot have, and why."""


@dataclass(frozen=True, eq=False)
class Case:
    """What sections draw.

    Parameters
    ----------
    runs : reconstructions of one scan, the first one is shown in detail
    dataset : the scan, open; None where it was not found
    truth : what was scanned; None where that is not known
    folder : where figures are drawn
    """

    runs: tuple[FinishedRun, ...]
    dataset: Dataset | None
    truth: Truth | None
    folder: Path

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Bases that are drawn: those of any run, in the order of the truth or else of the first one."""
        known = [name for run in self.runs for name in run.basis_names]
        order = [*(self.truth.basis_names if self.truth is not None else ()), *known]
        return tuple(name for name in dict.fromkeys(order) if name in known)

    @property
    def grid(self) -> Grid:
        """Voxels to compare on: those of the truth, or else of the first run."""
        return self.runs[0].grid if self.truth is None else self.truth.grid

    @cached_property
    def true(self) -> Float[np.ndarray, "basis z y x"] | None:
        """True volumes of `names` [1/mm]; None without truth, or where it is stated in other bases."""
        if self.truth is None or not set(self.names) <= set(self.truth.basis_names):
            return None
        return self.truth.volumes[[self.truth.basis_names.index(name) for name in self.names]]

    @cached_property
    def labels(self) -> Integer[np.ndarray, "z y x"]:
        """What fills most of each voxel, as the truth has it."""
        return self.needs_truth().labels

    def volumes(self, run: FinishedRun) -> Float[np.ndarray, "basis z y x"]:
        """Volumes of `names` on `grid` [1/mm]; zeros for bases that the run lacks."""
        return np.stack([run.volume(name, self.grid) for name in self.names])

    def label(self, run: FinishedRun) -> str:
        """How a run is called in a legend."""
        return run.name if len(self.runs) > 1 else "result"

    def who(self, run: FinishedRun) -> str:
        """What a caption begins with."""
        return f"{run.name}: " if len(self.runs) > 1 else ""

    def path(self, name: str) -> Path:
        """Name of a figure to draw."""
        return self.folder / f"{name}.svg"

    def needs_truth(self) -> Truth:
        """The truth, in bases that the runs share with it."""
        if self.truth is None:
            raise LeftOut("no truth: the dataset was not found, or has none")
        if self.true is None:
            raise LeftOut("the truth is stated in other bases than the reconstruction")
        return self.truth

    def needs_dataset(self) -> Dataset:
        """The dataset."""
        if self.dataset is None:
            raise LeftOut("the dataset was not found: name it by --dataset")
        return self.dataset


def check_same_scan(runs: Sequence[FinishedRun]) -> str:
    """Name of the dataset that all runs reconstruct.

    Raises
    ------
    InputError
        When they are of different scans.
    """
    names = [str(run.metrics.get("dataset", "")) for run in runs]
    for run, name in zip(runs, names, strict=True):
        if name != names[0]:
            raise InputError(
                f"runs of different scans do not fit on one page: {runs[0].folder} is of {names[0]}, {run.folder} of "
                f"{name}"
            )
    return names[0]


def number(value: Any, layout: str = ".2f") -> str:
    """A number for a table; a dash where there is none."""
    return "–" if value is None or (isinstance(value, float) and not np.isfinite(value)) else format(value, layout)
