"""One writer for each output: a small file beside it says which process, and ends with it."""

import json
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from spectra.errors import InputError

SUFFIX = ".lock"


@contextmanager
def output_lock(path: Path) -> Iterator[None]:
    """Keep other processes from writing the same output; a context manager.

    What a process that was killed left is taken over, where that process was of the same computer.

    Parameters
    ----------
    path : name of the output

    Yields
    ------
    nothing

    Raises
    ------
    InputError
        When another process writes this output.
    """
    lock = acquire(path)
    try:
        yield
    finally:
        lock.unlink(missing_ok=True)


def acquire(path: Path) -> Path:
    """Write the lock of an output.

    Parameters
    ----------
    path : name of the output

    Returns
    -------
    the lock, a file that the caller removes

    Raises
    ------
    InputError
        When another process writes this output.
    """
    lock = _lock_of(path)
    mine = json.dumps({"pid": os.getpid(), "host": socket.gethostname()}).encode()
    for _ in range(2):
        try:
            number = os.open(lock, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)
        except FileExistsError:
            _refuse_living(path, lock)
            lock.unlink(missing_ok=True)
            continue
        with open(number, "wb") as file:
            file.write(mine)
        return lock
    raise InputError(f"the output {path} is being written by another process: wait, or choose another name")


def refuse_locked(path: Path) -> None:
    """Refuse an output that another process writes, before any work is done.

    Parameters
    ----------
    path : name of the output

    Raises
    ------
    InputError
        When it is so.
    """
    if _lock_of(path).exists():
        _refuse_living(path, _lock_of(path))


def _lock_of(path: Path) -> Path:
    """Name of the lock of an output."""
    return path.absolute().with_name(path.absolute().name + SUFFIX)


def _refuse_living(path: Path, lock: Path) -> None:
    """Refuse an output whose lock is that of a process that may still run."""
    try:
        owner = json.loads(lock.read_bytes() or b"{}")
        number, host = int(owner["pid"]), str(owner["host"])
    except (OSError, ValueError, KeyError, TypeError):
        return  # torn: its process was killed while it wrote the lock
    if host != socket.gethostname():
        raise InputError(
            f"the output {path} is being written by process {number} on {host}: wait, choose another name, or remove "
            f"{lock.name} if that process has ended"
        )
    if _runs(number):
        raise InputError(f"the output {path} is being written by process {number}: wait, or choose another name")


def _runs(number: int) -> bool:
    """Whether a process of this computer runs."""
    if os.name == "nt":  # signals mean something else there
        return True
    try:
        os.kill(number, 0)
    except ProcessLookupError:
        return False
    except (PermissionError, OverflowError):
        return True
    return True
