"""JSON of results: numbers of numpy become numbers; NaN and infinity, which JSON lacks, become null."""

import json
from collections.abc import Mapping
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np


def plain(value: Any) -> Any:
    """Convert a value to dict, list, str, int, float, bool and None.

    Parameters
    ----------
    value : nested mappings and sequences that may hold numbers and arrays of numpy, and paths

    Returns
    -------
    the converted value

    Raises
    ------
    TypeError
        When something in it has no counterpart in JSON.
    """
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): plain(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [plain(part) for part in value]
    if isinstance(value, float):
        return value if isfinite(value) else None
    if value is None or isinstance(value, str | int):
        return value
    if isinstance(value, Path):
        return str(value)
    raise TypeError(f"an object of type {type(value).__name__} has no counterpart in JSON: {value!r:.80}")


def to_json(value: Any, indent: int | None = None) -> str:
    """Convert a value to JSON.

    Parameters
    ----------
    value : as for `plain`
    indent : blanks per level; None for one line

    Returns
    -------
    the JSON
    """
    return json.dumps(plain(value), indent=indent, allow_nan=False)


def write_json(path: Path, content: Any) -> None:
    """Write a value as indented JSON.

    Parameters
    ----------
    path : the file
    content : as for `plain`
    """
    path.write_text(to_json(content, 1) + "\n", encoding="utf-8")
