"""Outputs that exist: the checks before any work, and their messages, for all commands."""

import os
from collections.abc import Callable
from pathlib import Path

from spectra.errors import InputError


def check_output(path: Path, overwrite: bool, option: str = "--out", example: str = "scan.h5") -> None:
    """Refuse an output file that exists or has no folder, before any work is done.

    Parameters
    ----------
    path : name of the output
    overwrite : whether an existing file may be replaced
    option : option that names the output, for the message
    example : name of such a file, for the message

    Raises
    ------
    InputError
        When the output cannot be written.
    """
    if path.is_dir():
        raise InputError(f"the output {path} is a folder: name a file in it, such as {path / example}")
    refuse_existing(path, overwrite, option)
    check_parent(path)


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
