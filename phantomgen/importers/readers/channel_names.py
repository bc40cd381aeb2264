"""Names of channels from names of files."""

import re
from collections.abc import Sequence
from pathlib import Path

from spectra.errors import InputError


def channel_names(paths: Sequence[Path]) -> tuple[str, ...]:
    """Return the names of channels that are stored one per file or folder.

    Parameters
    ----------
    paths : files or folders

    Returns
    -------
    names of letters, digits and underscores; ``signal`` where there is one

    Raises
    ------
    InputError
        When two have the same name.
    """
    if len(paths) == 1:
        return ("signal",)
    names = tuple(clean(path.stem) for path in paths)
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError(f"two of the files are named {twice[0]!r}: channels need names of their own")
    return names


def clean(name: str) -> str:
    """Return a name of letters, digits and underscores.

    Parameters
    ----------
    name : any text

    Returns
    -------
    the name
    """
    return re.sub(r"\W+", "_", name.strip(), flags=re.ASCII).strip("_") or "signal"
