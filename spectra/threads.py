"""The one place that decides how many threads work.

Kernels are single-threaded numba functions that release the GIL; `run_parallel` hands independent pieces of work to
one pool. Each piece writes to its own output, so results do not depend on the number of threads. The pools of torch and
of linear algebra libraries would compete with ours, spinning while they wait (a fit then takes five times as long), so
long computations run inside `without_other_pools`.
"""

import os
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from itertools import islice
from typing import TypeVar

T = TypeVar("T")
R = TypeVar("R")

_worker = threading.local()
_state: dict[str, ThreadPoolExecutor | int | None] = {"pool": None, "count": None}
if hasattr(os, "register_at_fork"):  # threads do not survive a fork, as that of a data loader: its child makes its own
    os.register_at_fork(after_in_child=lambda: _state.update(pool=None))


def available_threads() -> int:
    """Return the number of threads this process may use.

    Returns
    -------
    ``OMP_NUM_THREADS`` if set, else the number of processors the process is allowed to run on
    """
    wish = os.environ.get("OMP_NUM_THREADS", "").split(",")[0]
    if wish.isdigit() and int(wish) > 0:
        return int(wish)
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def thread_count() -> int:
    """Return the number of threads in use.

    Returns
    -------
    number of threads
    """
    count = _state["count"]
    return count if isinstance(count, int) else available_threads()


def set_threads(count: int | None) -> None:
    """Set the number of threads.

    Parameters
    ----------
    count : number of threads; None for all that are available
    """
    pool = _state["pool"]
    if isinstance(pool, ThreadPoolExecutor):
        pool.shutdown()
    _state.update(pool=None, count=count)


@contextmanager
def without_other_pools() -> Iterator[None]:
    """Limit OpenMP and linear algebra libraries to one thread; a context manager, also a decorator.

    Yields
    ------
    nothing
    """
    from threadpoolctl import threadpool_limits  # noqa: PLC0415 - only where it is needed

    with threadpool_limits(limits=1):
        yield


def run_parallel(task: Callable[[T], R], items: Iterable[T], ahead: int = 2) -> Iterator[R]:
    """Yield ``task(item)`` for every item, in order, computed by the threads of one pool.

    A task may call this in turn: its own pieces then run one after the other, as all threads have work already.

    Parameters
    ----------
    task : function of one item
    items : independent pieces of work
    ahead : largest number of results per thread that wait to be taken

    Yields
    ------
    results in the order of `items`
    """
    threads = thread_count()
    if threads == 1 or hasattr(_worker, "working"):
        yield from map(task, items)
        return
    pool = _state["pool"]
    if not isinstance(pool, ThreadPoolExecutor):
        pool = _state["pool"] = ThreadPoolExecutor(threads, "kernel", initializer=_begin)
    source = iter(items)
    waiting = [pool.submit(task, item) for item in islice(source, ahead * threads)]
    while waiting:
        result = waiting.pop(0).result()
        waiting.extend(pool.submit(task, item) for item in islice(source, 1))
        yield result


def _begin() -> None:
    """Mark a thread of the pool."""
    _worker.working = True
