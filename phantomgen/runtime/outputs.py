"""Outputs that exist: the checks before any work, and their messages, for all commands."""

import os
from collections.abc import Callable
from pathlib import Path

from phantomgen.runtime.hdf5_signature import SIGNATURE
from spectra.errors import InputError, shortened

LONGEST_NAME = 240  # bytes; most file systems take 255, and files in work get a suffix


# How files of a suffix begin; others may be replaced whatever they hold.
_BEGINNINGS = {
    ".h5": (SIGNATURE,), ".hdf5": (SIGNATURE,), ".nxs": (SIGNATURE,), ".png": (b"\x89PNG",), ".gz": (b"\x1f\x8b",),
    ".html": (b"<!", b"<html"), ".htm": (b"<!", b"<html"), ".json": (b"{", b"["), ".ply": (b"ply",),
    ".nii": (b"\x5c\x01\x00\x00", b"\x00\x00\x01\x5c"), ".vti": (b"<?xml", b"<VTKFile"),
}  # fmt: skip


def check_output(
    path: Path,
    overwrite: bool,
    option: str = "--out",
    example: str = "scan.h5",
    kind: tuple[str, Callable[[Path], bool]] | None = None,
) -> None:
    """Refuse an output file that exists or has no folder, before any work is done.

    A file that exists is replaced only where it is a file of the kind that the command writes, or empty.

    Parameters
    ----------
    path : name of the output
    overwrite : whether an existing file may be replaced
    option : option that names the output, for the message
    example : name of such a file, for the message
    kind : what the command writes, for the message, and a function that tells whether a file is such a one; by the
        beginning of files of this suffix where None

    Raises
    ------
    InputError
        When the output cannot be written.
    """
    check_name(path, option)
    if path.is_dir():
        raise InputError(f"the output {path} is a folder: name a file in it, such as {path / example}")
    refuse_existing(path, overwrite, option)
    if path.exists():
        _check_replaceable(path, kind)
    check_parent(path)


def _check_replaceable(path: Path, kind: tuple[str, Callable[[Path], bool]] | None) -> None:
    """Refuse to replace what no such command wrote."""
    if not path.is_file():
        raise InputError(f"the output {path} is a device or a pipe and no file; it will not be replaced")
    what, is_own = kind or (f"a {path.suffix} file", _begins_as_named)
    if path.stat().st_size and not (_begins_as_named(path) and is_own(path)):
        raise InputError(f"the output {path} is not {what}; it will not be replaced: move it, or choose another name")


def _begins_as_named(path: Path) -> bool:
    """Whether a file begins as those of its suffix do."""
    known = _BEGINNINGS.get(path.suffix.lower())
    if known is None:
        return True
    try:
        with path.open("rb") as file:
            return file.read(16).lstrip().startswith(known)
    except OSError:
        return False


def check_name(path: Path, option: str = "--out") -> None:
    """Refuse a name that is empty or longer than file systems allow.

    Parameters
    ----------
    path : name of the output
    option : option that names the output, for the message

    Raises
    ------
    InputError
        When it is so.
    """
    if not path.name:
        raise InputError(f"the output {str(path)!r} names no file or folder: name one by {option}")
    if len(os.fsencode(path.name)) > LONGEST_NAME:
        raise InputError(
            f"the name of the output {shortened(path.name)} has {len(os.fsencode(path.name))} bytes, and file systems "
            f"take about {LONGEST_NAME} beside suffixes: choose a shorter one by {option}"
        )


def check_output_folder(
    path: Path, overwrite: bool, writer: str, is_own: Callable[[Path], bool], resume: str = ""
) -> None:
    """Refuse an output folder that exists, was not written by the same command, or cannot be made.

    Parameters
    ----------
    path : name of the output
    overwrite : whether an existing folder may be replaced
    writer : program or command that writes such folders, for the message
    is_own : tells whether a folder was written by it
    resume : what ``--resume`` would do, for the message; empty where there is no such option

    Raises
    ------
    InputError
        When the output cannot be written.
    """
    check_name(path)
    refuse_existing(path, overwrite, resume=resume)
    if os.path.lexists(path) and (path.is_symlink() or not is_own(path)):
        raise InputError(f"the output {path} is not a folder that {writer} wrote; it will not be replaced")
    check_parent(path)


def refuse_existing(path: Path, overwrite: bool, option: str = "--out", resume: str = "") -> None:
    """Refuse an output that exists.

    Parameters
    ----------
    path : name of the output
    overwrite : whether it may be replaced
    option : option that names the output, for the message
    resume : what ``--resume`` would do, for the message; empty where there is no such option

    Raises
    ------
    InputError
        When it exists and may not be replaced.
    """
    if os.path.lexists(path) and not overwrite:
        onward = f"add --resume to {resume}, " if resume else ""
        raise InputError(f"the output {path} exists: {onward}choose another name by {option}, or add --overwrite")


def refuse_interrupted(path: Path, resume: bool, overwrite: bool) -> None:
    """Refuse to begin where an interrupted run left what it finished.

    Parameters
    ----------
    path : file or folder of the interrupted run, which exists
    resume : go on with it
    overwrite : begin anew

    Raises
    ------
    InputError
        When neither is given.
    """
    if not (resume or overwrite):
        raise InputError(f"{path} holds what an interrupted run finished: go on by --resume, or anew by --overwrite")


def check_parent(path: Path) -> None:
    """Refuse an output whose folder does not exist or is not writable.

    Parameters
    ----------
    path : name of the output

    Raises
    ------
    InputError
        When it is so.
    """
    parent = path.absolute().parent
    if not parent.is_dir():
        raise InputError(f"the folder {path.parent} for the output {path.name} does not exist")
    if not os.access(parent, os.W_OK | os.X_OK):
        raise InputError(f"the folder {path.parent} for the output {path.name} is not writable: choose another")
