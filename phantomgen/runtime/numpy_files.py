"""Reading files of NumPy that may be damaged."""

import tokenize
import zipfile
from pathlib import Path
from typing import Any

import numpy as np


def load_numpy(path: Path, in_memory: bool = True) -> Any:
    """Open a ``.npy`` or ``.npz`` file without objects of Python.

    NumPy parses headers as Python and lets errors of the parser through.

    Parameters
    ----------
    path : the file
    in_memory : whether to read the values of a ``.npy`` file at once

    Returns
    -------
    the array, or the open archive

    Raises
    ------
    ValueError
        When the file is damaged, or of another kind.
    OSError
        When it cannot be opened.
    """
    try:
        return np.load(path, mmap_mode=None if in_memory else "r", allow_pickle=False)
    except (tokenize.TokenError, SyntaxError, TypeError, KeyError, OverflowError, EOFError, MemoryError) as error:
        raise ValueError("its header is damaged") from error
    except zipfile.BadZipFile as error:
        raise ValueError("it is a damaged archive") from error
