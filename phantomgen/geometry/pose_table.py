"""Poses of all views from a table: source, panel centre, column step and row step, (x, y, z) in mm."""

import csv
import zipfile
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from jaxtyping import Float

from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry
from phantomgen.runtime.numpy_files import load_numpy
from spectra.errors import InputError

NAMES = ("source", "panel_center", "column_step", "row_step")
_COLUMNS = [f"{name}_{axis}" for name in NAMES for axis in "xyz"]
_GROUP = "entry/geometry"
Table = dict[str, Float[np.ndarray, "view 3"]]


def read_poses(path: Path, panel: Panel) -> Geometry:
    """Read a table of poses, whose steps must have the pitch of the panel.

    Parameters
    ----------
    path : .csv with a header that names the columns source_x, source_y, source_z, panel_center_x, ... row_step_z;
        .npz or .h5 with arrays (view, 3) of the names source, panel_center, column_step and row_step; or a dataset
    panel : the pixel grid

    Returns
    -------
    poses of all views

    Raises
    ------
    InputError
        When the file cannot be read, lacks a column, holds something that is no number, or does not fit the panel.
    """
    readers = {".csv": _read_csv, ".npz": _read_npz, ".h5": _read_hdf5, ".hdf5": _read_hdf5}
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise InputError(f"{path}: a table of poses must be one of {', '.join(readers)}")
    if not path.is_file():
        raise InputError(f"{path}: there is no such file")
    table = reader(path)
    _check(path, table, panel)
    return Geometry(*(table[name] for name in NAMES), panel=panel)


def _read_csv(path: Path) -> Table:
    """From text."""
    try:
        lines = list(csv.reader(path.read_text(encoding="utf-8-sig").splitlines()))
    except UnicodeDecodeError:
        raise InputError(f"{path} cannot be read as a table: it is not UTF-8 text") from None
    header = [cell.strip() for cell in lines[0]] if lines else []
    missing = [name for name in _COLUMNS if name not in header]
    if missing:
        raise InputError(f"{path}:1: the header lacks the column {missing[0]!r}; it needs {', '.join(_COLUMNS)}")
    rows = [(number, cells) for number, cells in enumerate(lines[1:], 2) if any(cell.strip() for cell in cells)]
    values = np.array([_row(f"{path}:{number}", header, cells) for number, cells in rows]).reshape(-1, len(NAMES), 3)
    return {name: values[:, i] for i, name in enumerate(NAMES)}


def _row(place: str, header: list[str], cells: list[str]) -> list[float]:
    """Numbers of one line in the order of `_COLUMNS`."""
    if len(cells) != len(header):
        raise InputError(f"{place}: a row has {len(header)} cells like the header, got {len(cells)}")
    found = []
    for name in _COLUMNS:
        cell = cells[header.index(name)]
        try:
            found.append(float(cell))
        except ValueError:
            raise InputError(f"{place}: {name} must be a number [mm], got {cell!r}") from None
    return found


def _read_npz(path: Path) -> Table:
    """From arrays of numpy."""
    try:
        with load_numpy(path) as file:
            return {name: _numbers(path, name, file.get(name)) for name in NAMES}
    except (OSError, ValueError, TypeError, AttributeError, zipfile.BadZipFile) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path} cannot be read as a table of poses: it is damaged or no .npz file") from None


def _read_hdf5(path: Path) -> Table:
    """From HDF5, also from the geometry of a dataset."""
    try:
        with h5py.File(path, "r") as file:
            found = {name: file.get(f"{_GROUP}/{name}", file.get(name)) for name in NAMES}
            arrays = {name: node[()] if isinstance(node, h5py.Dataset) else None for name, node in found.items()}
    except OSError:
        raise InputError(f"{path} cannot be read as a table of poses: it is damaged or no HDF5 file") from None
    return {name: _numbers(path, name, array) for name, array in arrays.items()}


def _numbers(path: Path, name: str, array: Any) -> Float[np.ndarray, "view 3"]:
    """An array that must be there and hold three numbers per view."""
    if array is None:
        raise InputError(f"{path} lacks the array {name!r}; a table of poses needs {', '.join(NAMES)}, each (view, 3)")
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "fiu" or array.shape[1:] != (3,):
        raise InputError(f"{path}: {name} must hold numbers (view, 3) [mm], got {np.shape(array)}")
    return array.astype(np.float64)


def _check(path: Path, table: Table, panel: Panel) -> None:
    """Refuse tables that are empty, do not fit together or do not fit the panel."""
    counts = {name: len(values) for name, values in table.items()}
    if len(set(counts.values())) > 1:
        raise InputError(f"{path}: all arrays need one row per view, got {counts}")
    if not counts["source"]:
        raise InputError(f"{path} holds no poses")
    for name, values in table.items():
        bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
        if len(bad):
            raise InputError(f"{path}: {name} of view {bad[0]} is not finite")
    for name, pitch in (("column_step", panel.column_pitch), ("row_step", panel.row_pitch)):
        length = np.linalg.norm(table[name], axis=1)
        bad = np.flatnonzero(np.abs(length - pitch) > 1e-6 * pitch)
        if len(bad):
            raise InputError(
                f"{path}: {name} of view {bad[0]} is {length[bad[0]]:.7g} mm long, but the pitch is {pitch:g} mm"
            )
