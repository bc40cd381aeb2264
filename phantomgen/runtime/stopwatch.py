"""Stopwatch of stages, which logs them, and peak memory."""

import logging
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

_log = logging.getLogger(__name__)


class Stopwatch:
    """Stopwatch of named stages: ``with clock("fdk"): ...`` adds to ``clock.seconds``, and logs a line.

    Parameters
    ----------
    on_stage : called with the name when a stage begins
    """

    def __init__(self, on_stage: Callable[[str], None] = lambda name: None) -> None:
        self.on_stage = on_stage
        self.seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        """Time one stage."""
        self.on_stage(name)
        began = time.perf_counter()
        try:
            yield
        finally:
            seconds = time.perf_counter() - began
            self.seconds[name] = self.seconds.get(name, 0.0) + seconds
            if _log.isEnabledFor(logging.INFO):
                peak = peak_memory_mib()
                memory = "" if peak is None else f", peak memory so far {peak:.0f} MiB"
                _log.info("%s: %.1f s%s", name, seconds, memory)


def peak_memory_mib() -> float | None:
    """Return the largest memory this process has used.

    Returns
    -------
    memory [MiB]; None where the system does not tell
    """
    try:
        import resource  # noqa: PLC0415 - not on Windows
    except ImportError:
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (2**20 if sys.platform == "darwin" else 2**10)
