"""Whether a disk has room, and what to say when it has not."""

import errno
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from spectra.errors import InputError, StorageError

# Least and most room that is reserved for closing a file [byte].
_LEAST_RESERVE, _MOST_RESERVE = 1 << 16, 1 << 23
_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}


def free_bytes(path: Path) -> int:
    """Room left on the disk that holds the folder of `path` [byte]."""
    return shutil.disk_usage(path.absolute().parent).free


def check_room(path: Path, needed: float) -> None:
    """Refuse what cannot fit.

    Parameters
    ----------
    path : of an output, whose folder is there
    needed : room that it still takes [byte]
    """
    free = free_bytes(path)
    if needed > free:
        raise InputError(
            f"{path} needs about {readable(needed)} of disk while it is written, and {readable(free)} are free: "
            "make room, or choose another folder by --out"
        )


def reserve(path: Path) -> None:
    """Write a file of zeros, a small part of the room that is left, to be removed when it is needed."""
    size = min(max(free_bytes(path) // 64, _LEAST_RESERVE), _MOST_RESERVE)
    with path.open("wb", buffering=0) as file:
        if file.write(bytes(size)) < size:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def readable(size: float) -> str:
    """A number of bytes for people."""
    for unit, power in (("TB", 12), ("GB", 9), ("MB", 6), ("kB", 3)):
        if size >= 10**power:
            return f"{size / 10**power:.1f} {unit}"
    return f"{size:.0f} bytes"


@contextmanager
def one_sentence(path: Path, needed: float | None = None) -> Iterator[None]:
    """Turn what a file system or HDF5 says while `path` is written into one sentence.

    Parameters
    ----------
    path : the file
    needed : room that it still takes [byte], where somebody knows
    """
    try:
        yield
    except StorageError:
        raise
    except (OSError, RuntimeError) as error:
        if is_full(error):
            more = "" if needed is None else f" and about {readable(needed)} more are needed"
            free = readable(free_bytes(path))
            text = f"the disk is full, {free} are free{more}: make room and start again, `make` with --resume"
        elif isinstance(error, OSError):
            text = os.strerror(error.errno) if error.errno else "the file system refuses"
        else:
            raise
        raise StorageError(f"{path} cannot be written: {text}") from None


def is_full(error: BaseException) -> bool:
    """Whether an error of a file system or of HDF5 means that there is no room; HDF5 says so in words only."""
    return getattr(error, "errno", None) in _FULL or os.strerror(errno.ENOSPC) in str(error)


@contextmanager
def complete_file(path: Path, suffix: str) -> Iterator[Path]:
    """A name with the same suffix beside `path`, which it is renamed to at the end."""
    beside = path.with_name(f"{path.name}.part{suffix}")
    try:
        with one_sentence(path):
            yield beside
            beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)
