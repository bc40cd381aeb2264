"""Everything this project raises on purpose.

==================  ==========================================================================
Raise               when
==================  ==========================================================================
`InputError`        a value handed to a function or an option is wrong
`SceneError`        a scene file is wrong; carries file, line, column and key
`DatasetError`      a dataset file is damaged, of a newer schema, or lacks something
`GeometryError`     a scan geometry cannot be what the caller means
`NotInstalledError` an optional dependency is missing; names the command that installs it
`StorageError`      a disk is full or cannot be written; what was computed so far is kept
`Error`             never directly: it is what a command line catches
==================  ==========================================================================

Messages are one sentence: what is wrong, where, the value found, and what would be right.
A command line turns an `Error` into that sentence and exit code 1; anything else is a bug and shows its traceback.
"""

import re

LONGEST_QUOTE = 80  # characters of an input that a message quotes
LONGEST_WORD = 1000  # characters without a space that a command line prints, so that paths stay whole
LONGEST_MESSAGE = 4000  # characters of a sentence that a command line prints


def shortened(text: object, longest: int = LONGEST_QUOTE) -> str:
    """Shorten an input for a message.

    Parameters
    ----------
    text : what the user gave
    longest : number of characters

    Returns
    -------
    beginning and end of a long text, the whole of a short one
    """
    words = str(text)
    return words if len(words) <= longest else f"{words[: longest * 2 // 3]} ... {words[-longest // 4 :]}"


def concise(message: str) -> str:
    """Shorten long words of a message, which quote an input.

    Parameters
    ----------
    message : a sentence

    Returns
    -------
    the sentence; words of more than `LONGEST_WORD` characters and the middle of a very long sentence are left out
    """
    words = re.sub(rf"\S{{{LONGEST_WORD + 1},}}", lambda word: shortened(word[0]), message)
    return shortened(words, LONGEST_MESSAGE)


class Error(Exception):
    """Root of all errors raised on purpose."""


class InputError(Error, ValueError):
    """A value given to a function or an option is wrong."""


class SceneError(Error, ValueError):
    """A scene file is wrong; the message starts with ``file:line:column``."""


class DatasetError(Error, ValueError):
    """A dataset file is damaged, too new, or incomplete."""


class GeometryError(Error, ValueError):
    """A scan geometry is impossible or degenerate."""


class NotInstalledError(Error, ImportError):
    """An optional dependency is missing."""


class StorageError(Error, OSError):
    """A disk is full or cannot be written."""


class MachineWarning(UserWarning):
    """Something about this machine costs time or is not as it should be; results are correct."""
