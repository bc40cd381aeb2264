"""HDF5 files of other programs: arrays that must be there, their units, and frames that are read one by one."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from jaxtyping import Float, Shaped

from spectra.errors import InputError

# No compression of numbers makes them smaller than this (deflate: 1032).
_MOST_COMPRESSED = 1100
_LENGTHS = {"m": 1e3, "meter": 1e3, "metre": 1e3, "cm": 10.0, "mm": 1.0, "um": 1e-3, "µm": 1e-3, "micron": 1e-3,
            "microns": 1e-3, "micrometer": 1e-3, "micrometre": 1e-3, "nm": 1e-6}  # fmt: skip
_ANGLES = {"degree": 1.0, "degrees": 1.0, "deg": 1.0, "rad": 180 / np.pi, "radian": 180 / np.pi, "radians": 180 / np.pi}
_ENERGIES = {"kev": 1.0, "ev": 1e-3, "mev": 1e3, "j": 6.241509074e15}


def opened(path: Path) -> h5py.File:
    """Open a file for reading.

    Parameters
    ----------
    path : the file

    Returns
    -------
    the open file, which the caller's images keep open

    Raises
    ------
    InputError
        When it is missing, cut off, or no HDF5 file.
    """
    if not path.is_file():
        raise InputError(f"there is no file {path}")
    try:
        return h5py.File(path, "r")
    except OSError as error:
        reason = "it is cut off" if "truncated" in str(error) else "it is damaged or no HDF5 file"
        raise InputError(f"{path} cannot be read: {reason}") from None


@contextmanager
def readable(path: Path) -> Iterator[None]:
    """Convert errors of HDF5 on damaged bytes to a sentence; a context manager.

    Parameters
    ----------
    path : the file

    Yields
    ------
    nothing

    Raises
    ------
    InputError
        When a part cannot be read.
    """
    try:
        yield
    except (OSError, RuntimeError, KeyError):
        raise InputError(f"{path} is damaged: a part of it cannot be read") from None


def frames_at(parent: h5py.Group, name: str) -> h5py.Dataset:
    """Return a stack of images that must be there, and that the file can hold.

    Parameters
    ----------
    parent : group
    name : of the stack

    Returns
    -------
    the stack, three or four axes

    Raises
    ------
    InputError
        When it is missing, no images, or larger than the file.
    """
    with readable(Path(parent.file.filename)):
        found = parent.get(name)
    place = f"{parent.file.filename}: {_place(parent, name)}"
    if not isinstance(found, h5py.Dataset):
        raise InputError(f"{place} is missing")
    if found.ndim not in (3, 4) or found.dtype.kind not in "uif" or 0 in found.shape:
        raise InputError(f"{place} holds {found.dtype} of shape {found.shape}, expected images (frame, row, column)")
    if not found.is_virtual and not found.external:
        need, stored = found.size * found.dtype.itemsize, found.id.get_storage_size()
        if need > max(stored, 1) * (_MOST_COMPRESSED if found.compression or found.chunks else 1):
            raise InputError(f"{place} declares {need} bytes in {found.shape} and stores {stored}: it is cut off")
    return found


def value_at(parent: h5py.Group, *names: str) -> Any:
    """Return the first array of several names that is there, or None.

    Parameters
    ----------
    parent : group
    *names : paths

    Returns
    -------
    the array in the file, or None
    """
    with readable(Path(parent.file.filename)):
        found = (parent.get(name) for name in names)
        return next((one for one in found if isinstance(one, h5py.Dataset)), None)


def text_at(parent: h5py.Group, *names: str) -> str | None:
    """Return the text of the first array of several names that is there.

    Parameters
    ----------
    parent : group
    *names : paths

    Returns
    -------
    the text; None where there is none
    """
    found = value_at(parent, *names)
    if found is None or found.size != 1:
        return None
    with readable(Path(parent.file.filename)):
        value = np.ravel(found[()])[0]
    return value.decode(errors="replace") if isinstance(value, bytes) else str(value)


def numbers_of(array: h5py.Dataset, kind: str, default: str) -> Float[np.ndarray, " number"]:
    """Read finite numbers in mm, degrees or keV.

    Parameters
    ----------
    array : in the file
    kind : ``length``, ``angle``, ``energy``, or ``number`` without unit
    default : unit where the array states none

    Returns
    -------
    the numbers

    Raises
    ------
    InputError
        When they are no finite numbers, or of an unknown unit.
    """
    place = f"{array.file.filename}: {array.name}"
    if array.dtype.kind not in "uif" or int(array.size or 0) > 10_000_000:
        raise InputError(f"{place} must hold numbers, got {array.dtype} of shape {array.shape}")
    with readable(Path(array.file.filename)):
        values = np.ravel(np.asarray(array[()], dtype=np.float64))
        units = array.attrs.get("units", default)
    units = units.decode() if isinstance(units, bytes) else str(units)
    known = {"length": _LENGTHS, "angle": _ANGLES, "energy": _ENERGIES, "number": {units.lower(): 1.0}}[kind]
    if units.strip().lower() not in known:
        raise InputError(f"{place} has the unit {units!r}: choose from {', '.join(known)}")
    if not np.isfinite(values).all():
        raise InputError(f"{place} holds a value that is not finite")
    return values * known[units.strip().lower()]


def frame(stack: h5py.Dataset, number: int) -> Shaped[np.ndarray, "..."]:
    """Read one image of a stack.

    Parameters
    ----------
    stack : images in the file
    number : of the image

    Returns
    -------
    the image
    """
    with readable(Path(stack.file.filename)):
        return stack[number]


def _place(parent: h5py.Group, name: str) -> str:
    return f"{str(parent.name).rstrip('/')}/{name}"
