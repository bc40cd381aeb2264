"""Content of a report: runs, and where they are available the scan that they reconstruct and its truth."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, Integer

from phantomgen.dataset.reader import Dataset
from phantomgen.dataset.truth import Truth
from phantomgen.display.figures.style import BASIS_LINES, RESULT
from phantomgen.display.html import Part
from phantomgen.geometry.voxel_grid import Grid
from recon.output.report.finished_run import FinishedRun
from spectra.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Parts = tuple[Part, ...]
LINES = ((RESULT, "-"), *BASIS_LINES)  # colour and dashes of each run


class LeftOut(Exception):  # noqa: N818 - nothing is wrong
    """Reason for which a section is not possible for these runs."""


@dataclass(frozen=True, eq=False)
class Case:
    """Content of the sections of a report.

    Parameters
    ----------
    runs : reconstructions of one scan; the first one is shown in detail
    dataset : the scan, open; None where it was not found
    truth : truth of the scan; None where it is not known
    folder : folder for figures
    figures : of matplotlib, by the names of their files
    """

    runs: tuple[FinishedRun, ...]
    dataset: Dataset | None
    truth: Truth | None
    folder: Path
    figures: dict[str, "Figure"] = field(default_factory=dict)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Bases that are drawn: those of any run, in the order of the truth, or else of the first run."""
        known = [name for run in self.runs for name in run.basis_names]
        order = [*(self.truth.basis_names if self.truth is not None else ()), *known]
        return tuple(name for name in dict.fromkeys(order) if name in known)

    @property
    def grid(self) -> Grid:
        """Grid on which volumes are compared: that of the truth, or else of the first run."""
        return self.runs[0].grid if self.truth is None else self.truth.grid

    @cached_property
    def true(self) -> Float[np.ndarray, "basis z y x"] | None:
        """True volumes of `names` [1/mm]; None without truth, or where it has other bases."""
        if self.truth is None or not set(self.names) <= set(self.truth.basis_names):
            return None
        return self.truth.volumes[[self.truth.basis_names.index(name) for name in self.names]]

    @cached_property
    def labels(self) -> Integer[np.ndarray, "z y x"]:
        """Material that fills most of each voxel of the truth: 0 for background, i + 1 for material i."""
        return self.needs_truth().labels

    def volumes(self, run: FinishedRun) -> Float[np.ndarray, "basis z y x"]:
        """Return the volumes of a run.

        Parameters
        ----------
        run : a run of the report

        Returns
        -------
        coefficients of `names` on `grid` [1/mm]; zeros for bases that the run lacks
        """
        return np.stack([run.volume(name, self.grid) for name in self.names])

    def label(self, run: FinishedRun) -> str:
        """Return the name of a run in a legend.

        Parameters
        ----------
        run : a run of the report

        Returns
        -------
        name; ``result`` where there is one run only
        """
        return run.name if len(self.runs) > 1 else "result"

    def who(self, run: FinishedRun) -> str:
        """Return the beginning of a caption.

        Parameters
        ----------
        run : a run of the report

        Returns
        -------
        name and a colon; empty where there is one run only
        """
        return f"{run.name}: " if len(self.runs) > 1 else ""

    def drawn(self, path: Path, figure: "Figure") -> Path:
        """Keep a figure beside its file.

        Parameters
        ----------
        path : of the figure
        figure : that was written there

        Returns
        -------
        path
        """
        self.figures[path.stem] = figure
        return path

    def path(self, name: str) -> Path:
        """Return the path of a figure.

        Parameters
        ----------
        name : name of the figure

        Returns
        -------
        path in the folder for figures
        """
        return self.folder / f"{name}.svg"

    def needs_truth(self) -> Truth:
        """Return the truth.

        Returns
        -------
        truth, in bases that include those of the runs

        Raises
        ------
        LeftOut
            When there is none, or when it has other bases.
        """
        if self.truth is None:
            raise LeftOut("no truth: the dataset was not found, or has none")
        if self.true is None:
            raise LeftOut("the truth is stated in other bases than the reconstruction")
        return self.truth

    def needs_dataset(self) -> Dataset:
        """Return the dataset.

        Returns
        -------
        the open dataset

        Raises
        ------
        LeftOut
            When it was not found.
        """
        if self.dataset is None:
            raise LeftOut("the dataset was not found: name it by --dataset")
        return self.dataset


def check_same_scan(runs: Sequence[FinishedRun]) -> str:
    """Refuse runs of different scans.

    Parameters
    ----------
    runs : runs of the report

    Returns
    -------
    name of the dataset that all runs reconstruct

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
    """Format a number for a table.

    Parameters
    ----------
    value : a number, or None
    layout : format specification

    Returns
    -------
    text; a dash for None, NaN and infinity
    """
    return "–" if value is None or (isinstance(value, float) and not np.isfinite(value)) else format(value, layout)
