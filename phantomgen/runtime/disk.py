"""Disk space: checks before writing, and errors of full disks as sentences."""

import errno
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from phantomgen.runtime.output_lock import output_lock
from spectra.errors import InputError, StorageError

# Least and most room that is reserved for closing a file [byte].
_LEAST_RESERVE, _MOST_RESERVE = 1 << 16, 1 << 23
_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}


def free_bytes(path: Path) -> int:
    """Return the free room on the disk of a path's folder.

    Parameters
    ----------
    path : of an output, whose folder exists

    Returns
    -------
    room [byte]
    """
    return shutil.disk_usage(path.absolute().parent).free


def check_free_space(path: Path, needed: float) -> None:
    """Refuse an output that cannot fit on the disk.

    Parameters
    ----------
    path : of an output, whose folder is there
    needed : room that it still takes [byte]

    Raises
    ------
    InputError
        When the disk has less room.
    """
    free = free_bytes(path)
    if needed > free:
        raise InputError(
            f"{path} needs about {readable(needed)} of disk while it is written, and {readable(free)} are free: "
            "make room, or choose another folder by --out"
        )


def reserve(path: Path) -> None:
    """Write a file of zeros, a small part of the free room, to be removed when the room is required.

    Parameters
    ----------
    path : the file

    Raises
    ------
    OSError
        When the disk is full.
    """
    size = min(max(free_bytes(path) // 64, _LEAST_RESERVE), _MOST_RESERVE)
    with path.open("wb", buffering=0) as file:
        if file.write(bytes(size)) < size:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def readable(size: float) -> str:
    """Format a number of bytes as text.

    Parameters
    ----------
    size : [byte]

    Returns
    -------
    such as ``1.5 GB``
    """
    for unit, power in (("TB", 12), ("GB", 9), ("MB", 6), ("kB", 3)):
        if size >= 10**power:
            return f"{size / 10**power:.1f} {unit}"
    return f"{size:.0f} bytes"


@contextmanager
def one_sentence(path: Path, needed: float | None = None) -> Iterator[None]:
    """Convert errors of the file system or of HDF5 while `path` is written to one sentence; a context manager.

    Parameters
    ----------
    path : the file
    needed : room that it still takes [byte], where it is known

    Yields
    ------
    nothing

    Raises
    ------
    StorageError
        When the disk is full or cannot be written.
    """
    try:
        yield
    except StorageError:
        raise
    except (OSError, RuntimeError) as error:
        if is_full(error):
            more = "" if needed is None else f" and about {readable(needed)} more are needed"
            free = readable(free_bytes(path))
            full = f"the disk is full, {free} are free{more}"
            full = "files may not grow further here" if _beyond_limit(error) else full
            text = f"{full}: make room and start again, with --resume where there is one"
        elif isinstance(error, OSError):
            text = os.strerror(error.errno) if error.errno else "the file system refuses"
        else:
            raise
        raise StorageError(f"{path} cannot be written: {text}") from None


def _beyond_limit(error: BaseException) -> bool:
    """Whether a limit on the size of files was met, and not the end of the disk."""
    return getattr(error, "errno", None) == errno.EFBIG or os.strerror(errno.EFBIG) in str(error)


def is_full(error: BaseException) -> bool:
    """Return whether an error of a file system or of HDF5 means that there is no room.

    HDF5 says so in its message only.

    Parameters
    ----------
    error : the error

    Returns
    -------
    True where it does
    """
    return getattr(error, "errno", None) in _FULL or any(os.strerror(number) in str(error) for number in _FULL)


@contextmanager
def complete_file(path: Path, suffix: str) -> Iterator[Path]:
    """Yield a name with the same suffix beside `path`, which is renamed to `path` at the end.

    Parameters
    ----------
    path : final name
    suffix : of the file

    Yields
    ------
    the name to write
    """
    beside = path.with_name(f"{path.name}.part{suffix}")
    with one_sentence(path), output_lock(path):
        try:
            yield beside
            beside.replace(path)
        finally:
            beside.unlink(missing_ok=True)
