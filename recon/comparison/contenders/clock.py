"""The clock of a comparison: it stands still while results are kept, and can be set back to where a fit began."""

import time
from collections.abc import Iterator
from contextlib import contextmanager

CLOCKS = {"wall": time.perf_counter, "cpu": time.process_time}  # cpu: of all threads together


class Spent(BaseException):
    """The time of the largest budget is over; a method that is interrupted by this has left what counts."""


class Clock:
    """Seconds that a method has worked.

    Parameters
    ----------
    kind : ``wall``, or ``cpu`` for the processor's time, which does not depend on what else a machine does
    """

    def __init__(self, kind: str) -> None:
        self._now = CLOCKS[kind]
        self._began: float | None = None
        self._seconds = 0.0

    def seconds(self) -> float:
        """So far."""
        return self._seconds + (0.0 if self._began is None else self._now() - self._began)

    def start(self, at: float | None = None) -> None:
        """Run on, from `at` if it is given."""
        self._seconds = self.seconds() if at is None else at
        self._began = self._now()

    def stop(self) -> None:
        """Stand still."""
        self._seconds, self._began = self.seconds(), None

    @contextmanager
    def standing(self) -> Iterator[float]:
        """Stand still inside; yields the seconds so far."""
        running = self._began is not None
        self.stop()
        try:
            yield self._seconds
        finally:
            if running:
                self.start()
