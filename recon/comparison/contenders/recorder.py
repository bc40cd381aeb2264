"""What a method has reached at which time: models on disk, so that memory is that of the method alone."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from recon.comparison.contenders.clock import Clock, Spent

SPACING = 1.15  # seconds of a kept moment over those of the one before
Save = Callable[[Path], None]


@dataclass(frozen=True)
class Moment:
    """A model along the way.

    Parameters
    ----------
    seconds : worked until then
    done, total : iterations or steps made, and all that the method would make
    path : the model
    """

    seconds: float
    done: int
    total: int
    path: Path


class Recorder:
    """Keeps the last model within each budget, and some along the way for error against time.

    Parameters
    ----------
    clock : of the method; it stands still while models are written
    folder : an existing folder to write in
    budgets : [s]
    """

    def __init__(self, clock: Clock, folder: Path, budgets: Sequence[float]) -> None:
        self.clock, self.folder, self.budgets = clock, folder, sorted(budgets)
        self.moments: list[Moment] = []
        self.finished = False  # whether the method came to its own end
        self._spaced = 0.0
        self._count = 0

    def add(self, done: int, total: int, save: Save) -> None:
        """Keep a model if it counts.

        Raises
        ------
        Spent
            When the largest budget is over.
        """
        with self.clock.standing() as seconds:
            if seconds > self.budgets[-1]:
                raise Spent
            path = self.folder / str(self._count)
            self._count += 1
            save(path)
            if self.moments:
                self._settle(self.moments[-1], seconds)
            self.moments.append(Moment(seconds, done, total, path))

    def result(self, budget: float) -> Moment | None:
        """The last moment within a budget; None when there is none."""
        within = [moment for moment in self.moments if moment.seconds <= budget]
        return within[-1] if within else None

    def is_final(self, moment: Moment) -> bool:
        """Whether a method would not have gone on from there."""
        return self.finished and moment is self.moments[-1]

    def _settle(self, last: Moment, now: float) -> None:
        """Keep the moment before, or drop it: no budget ends between it and now, and it is close to the one before."""
        if any(last.seconds <= budget < now for budget in self.budgets):
            return
        if last.seconds >= SPACING * self._spaced:
            self._spaced = last.seconds
            return
        self.moments.pop()
        last.path.unlink()
