"""Volumes of NumPy files and of datasets in HDF5."""

import zipfile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from phantomgen.volume_files.volume import Volume, check_size, checked, triple
from spectra.errors import InputError

if TYPE_CHECKING:
    import h5py

_EVEN = 1e-3  # part of a voxel that positions on an axis may be off; they may be stored as float32


def read_npy(path: Path) -> Volume:
    """Read an array from a ``.npy`` file; objects are refused.

    Parameters
    ----------
    path : the file

    Returns
    -------
    the voxels

    Raises
    ------
    InputError
        When the file cannot be read, or holds no volume.
    """
    try:
        found = np.load(path, mmap_mode="r", allow_pickle=False)  # only the header is read here
    except (ValueError, EOFError, OSError) as error:
        raise InputError(f"{path}: the file cannot be read as an array of numbers: {_reason(error)}") from None
    if not isinstance(found, np.ndarray):
        found.close()
        raise InputError(f"{path}: the file is an archive of arrays: give it the suffix .npz")
    check_size(path, found.shape, found.dtype)
    return Volume(checked(path, np.array(found)))


def read_npz(path: Path, name: str | None) -> Volume:
    """Read an array from a ``.npz`` file; objects are refused.

    Parameters
    ----------
    path : the file
    name : of the array; None for the only one

    Returns
    -------
    the voxels

    Raises
    ------
    InputError
        When the file cannot be read, holds no volume, or several without a name.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            names = [info.filename.removesuffix(".npy") for info in archive.infolist()]
            if name is None and len(names) != 1:
                raise InputError(f"{path}: which of its arrays? Write {path.name}:NAME, one of {', '.join(names)}")
            if name is not None and name not in names:
                raise InputError(f"{path}: there is no array {name}, only {', '.join(names)}")
            member = f"{names[0] if name is None else name}.npy"
            with archive.open(member) as stream:
                version = np.lib.format.read_magic(stream)
                read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
                shape, _, dtype = read(stream)
            where = f"{path}:{member.removesuffix('.npy')}"
            check_size(where, shape, dtype)
            with archive.open(member) as stream:
                values = np.lib.format.read_array(stream, allow_pickle=False)
    except (ValueError, EOFError, OSError, KeyError, zipfile.BadZipFile, NotImplementedError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: the file cannot be read as an archive of arrays: {_reason(error)}") from None
    return Volume(checked(where, values))


def read_hdf5(path: Path, name: str) -> Volume:
    """Read a dataset of an HDF5 file.

    Its grid is that of the nearest group ``grid`` with ``spacing`` and ``origin``, as our own files have, or that of
    the axes of a NeXus plot. Its unit is its attribute ``units``.

    Parameters
    ----------
    path : the file
    name : path of the dataset inside the file

    Returns
    -------
    voxels, and their place where the file states it

    Raises
    ------
    InputError
        When the file cannot be read, there is no such dataset, or it is no volume.
    """
    import h5py  # noqa: PLC0415 - only where there is such a file

    try:
        with h5py.File(path, "r") as file:
            found = file.get(name)
            if not isinstance(found, h5py.Dataset):
                raise InputError(f"{path}: there is no dataset {name}")
            check_size(f"{path}:{name}", found.shape, found.dtype)
            values, letters = checked(path, found[()]), _letters(found)
            units = found.attrs.get("units")
            units = units.decode() if isinstance(units, bytes) else units
            spacing, origin = _grid(file, name) or _axes_of_plot(found, letters)
    except OSError as error:
        raise InputError(f"{path}: the file cannot be read as HDF5: {_reason(error)}") from None
    if letters not in ("", "zyx"):
        values = np.moveaxis(values, [values.ndim - 3 + letters.index(axis) for axis in "zyx"], (-3, -2, -1))
    return Volume(
        values,
        None if spacing is None else triple(spacing[::-1]),
        np.eye(3) if letters or origin is not None else None,
        None if origin is None else triple(origin[::-1]),
        units if isinstance(units, str) and units else None,
    )


def _letters(found: "h5py.Dataset") -> str:
    """Last three axes of a NeXus plot, such as ``zyx``; empty where the file does not name them."""
    axes = found.parent.attrs.get("axes", ())
    texts = [axis.decode() if isinstance(axis, bytes) else str(axis) for axis in np.atleast_1d(axes)]
    letters = "".join(texts[-3:])
    return letters if len(texts) == found.ndim and sorted(letters) == ["x", "y", "z"] else ""


def _grid(file: "h5py.File", name: str) -> tuple[np.ndarray, np.ndarray] | None:
    """Spacing and origin (z, y, x) of the nearest group ``grid``, from the dataset up."""
    import h5py  # noqa: PLC0415

    parent = name.rpartition("/")[0]
    while True:
        grid = file.get(f"{parent}/grid")
        if isinstance(grid, h5py.Group) and {"spacing", "origin"} <= set(grid):
            return np.array(grid["spacing"], dtype=np.float64), np.array(grid["origin"], dtype=np.float64)
        if not parent:
            return None
        parent = parent.rpartition("/")[0]


def _axes_of_plot(found: "h5py.Dataset", letters: str) -> tuple[np.ndarray, np.ndarray] | tuple[None, None]:
    """Spacing and origin (z, y, x) from evenly spaced positions in mm beside the dataset."""
    places = [found.parent.get(axis) for axis in "zyx"] if letters else []
    if not places or not all(p is not None and p.attrs.get("units") in ("mm", b"mm") and len(p) > 1 for p in places):
        return None, None
    positions = [np.array(place, dtype=np.float64) for place in places]
    steps = np.array([(p[-1] - p[0]) / (len(p) - 1) for p in positions])
    if not all(np.allclose(np.diff(p), s, atol=_EVEN * abs(s)) for p, s in zip(positions, steps, strict=True)):
        return None, None
    return steps, np.array([p[0] for p in positions])


def _reason(error: Exception) -> str:
    """First line of a message of a library."""
    return (str(error).strip().splitlines() or [type(error).__name__])[0]
