"""Models of a method over time, kept on disk, so that the measured memory is that of the method alone."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from recon.comparison.contenders.clock import BudgetSpent, Clock

SPACING = 1.15  # ratio of the times of two kept models; gives about 16 points per decade of time
Save = Callable[[Path], None]


@dataclass(frozen=True)
class RecordedModel:
    """A model between the steps of a method.

    Parameters
    ----------
    seconds : time that the method had worked [s]
    done, total : number of finished iterations or steps, and of all
    path : file of the model
    """

    seconds: float
    done: int
    total: int
    path: Path


class Recorder:
    """Recorder of the last model within each budget, and of some others for error against time.

    Parameters
    ----------
    clock : of the method; it is stopped while models are written
    folder : existing folder to write in
    budgets : [s]

    Attributes
    ----------
    recorded : models that were kept
    finished : whether the method came to its own end
    """

    def __init__(self, clock: Clock, folder: Path, budgets: Sequence[float]) -> None:
        self.clock, self.folder, self.budgets = clock, folder, sorted(budgets)
        self.recorded: list[RecordedModel] = []
        self.finished = False  # whether the method came to its own end
        self._spaced = 0.0
        self._count = 0

    def add(self, done: int, total: int, save: Save) -> None:
        """Keep a model, and remove the one before where it does not count.

        Parameters
        ----------
        done : number of finished iterations or steps
        total : number of all
        save : writes the model to a file

        Raises
        ------
        BudgetSpent
            When the largest budget is over.
        """
        with self.clock.paused() as seconds:
            if seconds > self.budgets[-1]:
                raise BudgetSpent
            path = self.folder / str(self._count)
            self._count += 1
            save(path)
            if self.recorded:
                self._settle(self.recorded[-1], seconds)
            self.recorded.append(RecordedModel(seconds, done, total, path))

    def result(self, budget: float) -> RecordedModel | None:
        """Return the last model within a budget.

        Parameters
        ----------
        budget : [s]

        Returns
        -------
        the model; None where there is none
        """
        within = [model for model in self.recorded if model.seconds <= budget]
        return within[-1] if within else None

    def is_final(self, model: RecordedModel) -> bool:
        """Tell whether a model is the final one of a method that came to its own end.

        Parameters
        ----------
        model : a model

        Returns
        -------
        True where it is
        """
        return self.finished and model is self.recorded[-1]

    def _settle(self, last: RecordedModel, now: float) -> None:
        """Remove the last model where no budget ends between it and now, and it is close in time to the one before."""
        if any(last.seconds <= budget < now for budget in self.budgets):
            return
        if last.seconds >= SPACING * self._spaced:
            self._spaced = last.seconds
            return
        self.recorded.pop()
        last.path.unlink()
