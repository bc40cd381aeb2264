"""Clock of a comparison: it is stopped while results are written, and can be set to the time at which a fit began."""

import time
from collections.abc import Iterator
from contextlib import contextmanager

CLOCKS = {"wall": time.perf_counter, "cpu": time.process_time}  # s; cpu: sum over all threads


class BudgetSpent(BaseException):
    """Signal that the time of the largest budget is over; the recorder has kept the models that count."""


class Clock:
    """Clock of the time that a method has worked.

    Parameters
    ----------
    kind : ``wall``, or ``cpu`` for processor time, which depends little on other programs on the machine
    """

    def __init__(self, kind: str) -> None:
        self._now = CLOCKS[kind]
        self._began: float | None = None
        self._seconds = 0.0

    def seconds(self) -> float:
        """Return the time so far.

        Returns
        -------
        time [s]
        """
        return self._seconds + (0.0 if self._began is None else self._now() - self._began)

    def start(self, at: float | None = None) -> None:
        """Start or continue.

        Parameters
        ----------
        at : time to begin at [s]; None for the time so far
        """
        self._seconds = self.seconds() if at is None else at
        self._began = self._now()

    def stop(self) -> None:
        """Stop."""
        self._seconds, self._began = self.seconds(), None

    @contextmanager
    def paused(self) -> Iterator[float]:
        """Stop the clock within a context.

        Yields
        ------
        time so far [s]
        """
        running = self._began is not None
        self.stop()
        try:
            yield self._seconds
        finally:
            if running:
                self.start()
