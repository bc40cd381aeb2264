"""A volume as a file states it: values, their place in space, and their unit, as far as the file says."""

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from spectra.errors import InputError

Triple = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Volume:
    """Voxel volume read from a file.

    Parameters
    ----------
    values : (z, y, x), or (part, z, y, x)
    spacing : distance between voxels along x, y and z of the array [mm], None where the file does not say
    directions : unit vectors along these as columns, None where the file does not say which axis is which
    origin : centre of the first voxel (x, y, z) [mm], None where the file does not say
    units : unit of the values, None where the file does not say
    names : of the parts, empty where the file has none
    """

    values: np.ndarray
    spacing: Triple | None = None
    directions: Float[np.ndarray, "3 3"] | None = None
    origin: Triple | None = None
    units: str | None = None
    names: tuple[str, ...] = ()


def checked(path: Path | str, values: np.ndarray) -> np.ndarray:
    """Return an array where it can be a volume.

    Parameters
    ----------
    path : the file, for the message
    values : the array

    Returns
    -------
    the array

    Raises
    ------
    InputError
        When it has the wrong number of axes, is empty, or holds something else than finite numbers.
    """
    check_size(path, values.shape, values.dtype)
    if values.dtype.kind == "f" and not np.isfinite(values).all():
        raise InputError(f"{path}: values must be finite, {(~np.isfinite(values)).sum()} are not")
    return values


def check_size(path: Path | str, shape: Sequence[int], dtype: Any) -> None:
    """Refuse an array that cannot be a volume, before its values are read.

    Parameters
    ----------
    path : the file, for the message
    shape, dtype : of the array

    Raises
    ------
    InputError
        When it has the wrong number of axes, is empty, holds no numbers, or does not fit into memory.
    """
    if len(shape) not in {3, 4} or 0 in shape:
        raise InputError(f"{path}: a volume must be (z, y, x) or (part, z, y, x), got shape {tuple(shape)}")
    if np.dtype(dtype).kind not in "uifb":
        raise InputError(f"{path}: a volume must hold numbers, got {np.dtype(dtype)}")
    need, there = float(np.prod(np.array(shape, dtype=np.float64))) * np.dtype(dtype).itemsize, _memory()
    if need > there:
        size = f"{' x '.join(map(str, shape))} voxels, {need / 2**30:.3g} GiB"
        raise InputError(f"{path}: the volume has {size}, more than the {there / 2**30:.3g} GiB of this machine")


def unit_in(text: str) -> str | None:
    """Find the unit that a description states in brackets, as our own exports do.

    Parameters
    ----------
    text : such as ``basis coefficients [1/mm]: photoelectric, compton``

    Returns
    -------
    the unit; None where there is none
    """
    found = re.search(r"\[(1/c?m|1/mm|g/cm\^3|mg/ml|HU)\]", text)
    return found.group(1) if found else None


def triple(values: Any) -> Triple:
    """Convert the first three numbers.

    Parameters
    ----------
    values : three numbers or more

    Returns
    -------
    the numbers
    """
    x, y, z = (float(value) for value in list(values)[:3])
    return x, y, z


def _memory() -> float:
    """Memory of the machine [byte]; infinite where the system does not tell."""
    try:
        return float(os.sysconf("SC_PHYS_PAGES")) * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, ValueError, OSError):  # not on Windows
        return np.inf
