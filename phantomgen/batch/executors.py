"""Many independent pieces of work on some executor, none of which is lost when a worker dies.

A pool of processes breaks as a whole when one of them is killed, as happens when memory runs out. Then a new pool takes
what is left, and pieces that were under way are tried once more, each alone, so that only the culprit fails.
"""

import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, ProcessPoolExecutor, wait
from contextlib import AbstractContextManager, contextmanager, nullcontext
from multiprocessing.connection import wait as wait_for
from typing import Any, TypeVar

from spectra.errors import Error, InputError, NotInstalledError

T = TypeVar("T")
R = TypeVar("R")
Pool = Callable[[int], AbstractContextManager[Executor]]
_PATIENCE = "20s"


def results(
    work: Callable[[T], R], items: Iterable[T], pool: Pool, workers: int, ahead: int | None = 2
) -> Iterator[tuple[T, R | Exception]]:
    """Yield each item with its result, or with the error that ended it, in the order in which they finish.

    Parameters
    ----------
    work : what is done; it has to be importable by other processes
    items : what it is done to
    pool : opens an executor of so many workers
    workers : how many
    ahead : items per worker that are handed over at a time; None for all of them

    Yields
    ------
    item, and result or error
    """
    waiting, suspects = deque(items), list[T]()
    while waiting:
        with pool(workers) as executor:
            yield from _until_broken(work, waiting, executor, None if ahead is None else ahead * workers, suspects)
    for item in suspects:
        with pool(1) as executor:
            yield item, _result(executor.submit, work, item)


def process_pool(workers: int) -> AbstractContextManager[Executor]:
    """Open a pool of processes of this machine, one thread each; they end with this process.

    Parameters
    ----------
    workers : number of processes

    Returns
    -------
    the pool, as a context manager
    """
    return _process_pool(workers)


def own_executor(executor: Executor) -> Pool:
    """Return a pool that uses an executor of the caller and leaves it open.

    Parameters
    ----------
    executor : the executor

    Returns
    -------
    function of the number of workers
    """
    return lambda workers: nullcontext(executor)


def dask_pool(address: str) -> Pool:
    """Return a pool of workers of a Dask cluster, which restarts dead workers by itself.

    Parameters
    ----------
    address : of the scheduler

    Returns
    -------
    function of the number of workers
    """
    return lambda workers: _dask_pool(address)


def _until_broken(
    work: Callable[[T], R], waiting: deque[T], executor: Executor, most: int | None, suspects: list[T]
) -> Iterator[tuple[T, R | Exception]]:
    """Results until nothing is left, or the executor is broken; then what was under way is suspect."""
    running: dict[Future, T] = {}
    broken = False
    while running or (waiting and not broken):
        while waiting and not broken and (most is None or len(running) < most):
            try:
                running[executor.submit(work, waiting[0])] = waiting[0]
            except BrokenExecutor:
                broken = True
                suspects.extend([] if running else [waiting.popleft()])
            else:
                waiting.popleft()
        for future in wait(running, return_when=FIRST_COMPLETED).done:
            item = running.pop(future)
            result = _result(lambda future: future, future)
            if isinstance(result, BrokenExecutor):
                broken = True
                suspects.append(item)
            else:
                yield item, result


def _result(submit: Callable[..., Future], *arguments: Any) -> Any:
    """Return the result of a piece of work, or the error that ended it."""
    try:
        return submit(*arguments).result()
    except Exception as error:
        return error


@contextmanager
def _process_pool(workers: int) -> Iterator[Executor]:
    """Processes that are ended at once when something goes wrong here."""
    others = set(multiprocessing.active_children())
    context = multiprocessing.get_context("spawn")
    executor = ProcessPoolExecutor(workers, mp_context=context, initializer=_begin)
    try:
        yield executor
    except BaseException:
        for process in set(multiprocessing.active_children()) - others:
            process.terminate()
        executor.shutdown(cancel_futures=True)
        raise
    executor.shutdown()


def _begin() -> None:
    """Prepare a worker: leave Ctrl-C to the parent, end when it ends, and compute with one thread."""
    from threadpoolctl import threadpool_limits  # noqa: PLC0415

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    threadpool_limits(limits=1)


def _end_with_parent() -> None:
    """End this process when its parent is gone, even if that was killed."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait_for([parent.sentinel])
        os._exit(1)


@contextmanager
def _dask_pool(address: str) -> Iterator[Executor]:
    """A client's executor."""
    try:
        from distributed import Client  # noqa: PLC0415 - an extra
    except ImportError:
        raise NotInstalledError("--cluster needs the extra cluster: pip install 'spectral-ct[cluster]'") from None
    try:
        client = Client(address, timeout=_PATIENCE)
    except (OSError, ValueError) as error:
        reason = str(error).splitlines()[0] if str(error) else "no answer"
        raise InputError(
            f"there is no Dask scheduler at {address} ({reason}): start one by 'dask scheduler', which says its address"
        ) from None
    with client:
        executor = client.get_executor(pure=False)
        try:
            yield executor
        except BaseException:
            executor.shutdown(wait=False)
            raise


def sentence(error: Exception) -> str:
    """Return a sentence about an error that ended an item.

    Parameters
    ----------
    error : the error

    Returns
    -------
    the sentence
    """
    if isinstance(error, BrokenExecutor):
        return "its process was ended from outside, as happens when memory runs out"
    text = " ".join(str(error).split())
    return text if isinstance(error, Error) else f"{type(error).__name__}: {text}"
