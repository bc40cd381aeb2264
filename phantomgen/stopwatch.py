"""Seconds per stage."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager


class Stopwatch:
    """Times named stages: ``with clock("fdk"): ...`` adds to ``clock.seconds``.

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
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - began
