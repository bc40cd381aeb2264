"""Volumes of NumPy files and of datasets in HDF5."""

import zipfile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from phantomgen.runtime.numpy_files import load_numpy
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
        found = load_numpy(path, in_memory=False)  # only the header is read here
    except (ValueError, EOFError, OSError) as error:
        reason = "it is cut off" if "mmap length" in str(error) else _reason(error)
        raise InputError(f"{path}: the file cannot be read as an array of numbers: {reason}") from None
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


def read_hdf5(path: Path, name: str | None) -> Volume:
    """Read a dataset of an HDF5 file.

    Its grid is that of the nearest group ``grid`` with ``spacing`` and ``origin``, as our own files have, or that of
    the axes of a NeXus plot. Its unit is its attribute ``units``.

    Parameters
    ----------
    path : the file
    name : path of the dataset inside the file; None for the default plot of a NeXus file, as our volumes are

    Returns
    -------
    voxels, and their place and the names of their parts where the file states them

    Raises
    ------
    InputError
        When the file cannot be read, there is no such dataset, or it is no volume.
    """
    import h5py  # noqa: PLC0415 - only where there is such a file

    try:
        with h5py.File(path, "r") as file:
            name = name or _default_plot(file)
            if name is None:
                raise InputError(f"{path}: which of its datasets? Write {path.name}:/path")
            found = file.get(name)
            if not isinstance(found, h5py.Dataset):
                raise InputError(f"{path}: there is no dataset {name}")
            check_size(f"{path}:{name}", found.shape, found.dtype)
            values, letters = checked(path, found[()]), _letters(found)
            units = _text(found.attrs.get("units"))
            spacing, origin = _grid(file, name) or _axes_of_plot(found, letters)
            names = _names(found)
    except OSError as error:
        raise InputError(f"{path}: the file cannot be read as HDF5: {_reason(error)}") from None
    if letters not in ("", "zyx"):
        values = np.moveaxis(values, [values.ndim - 3 + letters.index(axis) for axis in "zyx"], (-3, -2, -1))
    return Volume(
        values,
        None if spacing is None else triple(spacing[::-1]),
        np.eye(3) if letters or origin is not None else None,
        None if origin is None else triple(origin[::-1]),
        units or None,
        names,
    )


def _default_plot(file: "h5py.File") -> str | None:
    """Path of what NeXus programs show first."""
    import h5py  # noqa: PLC0415

    group: h5py.File | h5py.Group = file
    while isinstance(below := group.get(_text(group.attrs.get("default")) or "-"), h5py.Group) and below != group:
        group = below
    signal = _text(group.attrs.get("signal"))
    return f"{group.name}/{signal}" if signal and isinstance(group.get(signal), h5py.Dataset) else None


def _names(found: "h5py.Dataset") -> tuple[str, ...]:
    """Names of the parts of a plot, which stand beside it under the name of its first axis."""
    axes = [_text(axis) for axis in np.atleast_1d(found.parent.attrs.get("axes", ()))]
    names = _group_of(found).get(axes[0]) if found.ndim == 4 and axes and axes[0] else None
    if not isinstance(names, type(found)) or names.shape != found.shape[:1] or names.dtype.kind not in "OS":
        return ()
    return tuple(str(name) for name in names.asstr()[()])


def _group_of(found: "h5py.Dataset") -> "h5py.Group":
    """Group that holds a dataset."""
    import h5py  # noqa: PLC0415

    parent = found.parent
    assert isinstance(parent, h5py.Group)
    return parent


def _text(value: object) -> str:
    """Text of an attribute; empty where there is none."""
    return value.decode() if isinstance(value, bytes) else value if isinstance(value, str) else ""


def _letters(found: "h5py.Dataset") -> str:
    """Last three axes of a NeXus plot, such as ``zyx``; empty where the file does not name them."""
    axes = found.parent.attrs.get("axes", ())
    texts = [_text(axis) for axis in np.atleast_1d(axes)]
    letters = "".join(texts[-3:])
    return letters if len(texts) == found.ndim and sorted(letters) == ["x", "y", "z"] else ""


def _grid(file: "h5py.File", name: str) -> tuple[np.ndarray, np.ndarray] | None:
    """Spacing and origin (z, y, x) of the nearest group ``grid``, from the dataset up."""
    import h5py  # noqa: PLC0415

    parent = name.rpartition("/")[0]
    while True:
        grid = file.get(f"{parent}/grid")
        if isinstance(grid, h5py.Group) and {"spacing", "origin"} <= set(grid):
            each = {key: grid[key] for key in ("spacing", "origin")}
            for key, stored in each.items():
                if not isinstance(stored, h5py.Dataset) or stored.shape != (3,) or stored.dtype.kind not in "iuf":
                    raise InputError(f"{file.filename}: {grid.name}/{key} must be three numbers (z, y, x) in mm")
            return np.array(each["spacing"], np.float64), np.array(each["origin"], np.float64)
        if not parent:
            return None
        parent = parent.rpartition("/")[0]


def _axes_of_plot(found: "h5py.Dataset", letters: str) -> tuple[np.ndarray, np.ndarray] | tuple[None, None]:
    """Spacing and origin (z, y, x) from evenly spaced positions in mm beside the dataset."""
    import h5py  # noqa: PLC0415

    beside = [_group_of(found).get(axis) for axis in "zyx"] if letters else []
    places = [place for place in beside if isinstance(place, h5py.Dataset)]
    if len(places) < 3 or not all(_text(p.attrs.get("units")) == "mm" and p.shape[0] > 1 for p in places):
        return None, None
    positions = [np.array(place, dtype=np.float64) for place in places]
    steps = np.array([(p[-1] - p[0]) / (len(p) - 1) for p in positions])
    if not all(np.allclose(np.diff(p), s, atol=_EVEN * abs(s)) for p, s in zip(positions, steps, strict=True)):
        return None, None
    return steps, np.array([p[0] for p in positions])


def _reason(error: Exception) -> str:
    """First line of a message of a library."""
    return (str(error).strip().splitlines() or [type(error).__name__])[0]
