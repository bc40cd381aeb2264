"""Pieces of work that the threads share."""

from collections.abc import Callable, Iterable
from typing import Any

from spectra.threads import run_parallel


def run_all(task: Callable[[Any], None], items: Iterable[Any]) -> None:
    """Run a task for every item, on all threads.

    Parameters
    ----------
    task : writes to an output of its own for each item
    items : arguments of the task, one per piece of work
    """
    for _ in run_parallel(task, items):
        pass


def run_in_pieces(task: Callable[[int, int], None], count: int, size: int) -> None:
    """Run ``task(first, last)`` for consecutive ranges that cover ``range(count)``, on all threads.

    Parameters
    ----------
    task : writes to an output of its own for each range
    count : number of indices
    size : indices per range; the last range may have fewer
    """
    run_all(lambda first: task(first, min(first + size, count)), range(0, count, size))
