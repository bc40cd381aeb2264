"""Ctrl-C and SIGTERM that end a fit after its current step."""

import signal
import threading
from types import FrameType
from typing import Any

_SIGNALS = (signal.SIGINT, signal.SIGTERM)  # torchrun and batch systems send the second


class Interruption:
    """Context in which the first Ctrl-C or SIGTERM sets `asked`, and the next one ends the process at once.

    Outside the main thread, where Python handles no signals, it does nothing.

    Attributes
    ----------
    asked : whether a signal has come
    """

    def __init__(self) -> None:
        self.asked = False
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> "Interruption":
        if threading.current_thread() is threading.main_thread():
            self._before = {number: signal.signal(number, self._ask) for number in _SIGNALS}
        return self

    def __exit__(self, *exception: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _ask(self, number: int, frame: FrameType | None) -> None:
        if self.asked:
            raise KeyboardInterrupt
        self.asked = True
