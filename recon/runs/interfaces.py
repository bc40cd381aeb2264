"""Interfaces between a run, its method of reconstruction, and the program that shows its progress."""

import warnings
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from phantomgen.dataset.reader import Dataset
from phantomgen.dataset.truth import Truth
from phantomgen.runtime.guarded import Guard
from phantomgen.runtime.stopwatch import Stopwatch
from recon.gaussians.optimize import Progress
from recon.voxel.method import Iteration


@runtime_checkable
class Watcher(Protocol):
    """Interface of what shows the progress of a run."""

    def stage(self, name: str) -> None:
        """Show that a stage begins.

        Parameters
        ----------
        name : of the stage, as in ``seconds`` of ``metrics.json``
        """

    def step(self, progress: Progress) -> None:
        """Show a finished step of a fit of Gaussians.

        Parameters
        ----------
        progress : number of the step, its deviance and chi-square
        """

    def iterated(self, iteration: Iteration) -> None:
        """Show a finished iteration of a voxel or view method, or of the start of a fit of Gaussians.

        Parameters
        ----------
        iteration : number of the iteration and its residual
        """

    def note(self, sentence: str) -> None:
        """Show a decision of the run.

        Parameters
        ----------
        sentence : for the user
        """

    def warn(self, sentence: str, error: Exception) -> None:
        """Show that a score or a figure failed.

        Parameters
        ----------
        sentence : for the user
        error : its cause
        """


class Unwatched:
    """A `Watcher` that shows nothing but warnings."""

    def stage(self, name: str) -> None:
        """Show nothing.

        Parameters
        ----------
        name : of the stage
        """

    def step(self, progress: Progress) -> None:
        """Show nothing.

        Parameters
        ----------
        progress : of a fit
        """

    def iterated(self, iteration: Iteration) -> None:
        """Show nothing.

        Parameters
        ----------
        iteration : of a method
        """

    def note(self, sentence: str) -> None:
        """Show nothing.

        Parameters
        ----------
        sentence : for the user
        """

    def warn(self, sentence: str, error: Exception) -> None:
        """Warn that a score or a figure failed.

        Parameters
        ----------
        sentence : for the user
        error : its cause
        """
        warnings.warn(f"{sentence} ({error})", RuntimeWarning, stacklevel=3)


@runtime_checkable
class Outcome(Protocol):
    """Interface of a finished reconstruction, which a run writes, scores and draws."""

    @property
    def left_out(self) -> tuple[str, ...]:
        """Names of the dataset's basis functions that were not reconstructed."""
        ...

    def write(self, folder: Path) -> None:
        """Write model, volumes and settings.

        Parameters
        ----------
        folder : run folder
        """

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
        ...

    def draw(self, truth: Truth | None, folder: Path, guard: Guard) -> None:
        """Draw all figures.

        Parameters
        ----------
        truth : of the dataset; None where it has none
        folder : of the figures
        guard : of each figure; what it catches is left out
        """


@runtime_checkable
class RunMethod(Protocol):
    """Interface of a method of reconstruction with all that steers it."""

    def check(self, dataset: Dataset) -> None:
        """Refuse a dataset or settings that the method cannot work with, before any work.

        Parameters
        ----------
        dataset : open dataset, of which counts are not read
        """

    def reconstruct(self, dataset: Dataset, folder: Path | None, clock: Stopwatch, watcher: Watcher) -> Outcome:
        """Reconstruct from the training views.

        Parameters
        ----------
        dataset : open dataset; only ``/entry`` is read
        folder : run folder, for checkpoints and the log; None where another process writes it
        clock : times the stages
        watcher : shows the progress

        Returns
        -------
        the finished reconstruction
        """
        ...
