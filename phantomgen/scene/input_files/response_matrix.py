"""Response matrices from files: CSV with its energies inside, or an array whose energies the scene declares."""

import csv
import re
from pathlib import Path

import numpy as np
from jaxtyping import Float

from phantomgen.runtime.numpy_files import load_numpy
from phantomgen.scene import schema
from spectra.detector.response_matrix import ResponseMatrix
from spectra.errors import InputError

Axis = Float[np.ndarray, " _n"]
Matrix = Float[np.ndarray, "row column"]


def read_response(model: schema.ResponseMatrixModel, folder: Path, top: float) -> ResponseMatrix:
    """Read the response matrix of a scene and create its detector.

    Parameters
    ----------
    model : what the scene says
    folder : where relative file names start
    top : highest energy of the source [keV]

    Returns
    -------
    the detector

    Raises
    ------
    InputError
        With the name of the file, where it is missing, or not what the scene declares.
    """
    deposited = model.columns == "deposited"
    _check_declared(model)
    try:
        if Path(model.file).suffix.lower() == ".csv":
            energy, columns, matrix = _read_csv(folder / model.file, numbered=deposited)
        else:
            matrix = _read_array(model.file, folder)
            if matrix.ndim != 2:
                raise InputError(f"a response matrix has two axes, got shape {matrix.shape}")
            energy = _axis(model.energies, matrix.shape[0])
            columns = _axis(model.deposited, matrix.shape[1])
        if not deposited:
            return ResponseMatrix.of_channels(energy, matrix, model.thresholds, top)
        return ResponseMatrix.of_deposited(energy, columns, matrix, model.thresholds, top, model.per == "keV")
    except InputError as error:
        raise InputError(f"{model.file}: {error}") from None


def _check_declared(model: schema.ResponseMatrixModel) -> None:
    """Refuse keys that are missing or say what the file itself says."""
    is_csv, deposited = Path(model.file).suffix.lower() == ".csv", model.columns == "deposited"
    if is_csv and (model.energies or model.deposited):
        raise InputError(
            "a CSV file has its energies in its first column and first line: leave out energies and deposited"
        )
    if not is_csv and model.energies is None:
        raise InputError("energies is missing: write energies: {first: 1, step: 1} for the rows of the matrix [keV]")
    if (model.deposited is not None) != (deposited and not is_csv):
        raise InputError(
            "deposited, such as {first: 0.5, step: 1}, belongs to arrays with columns: deposited, and to these only"
        )
    if (model.per is not None) != deposited:
        raise InputError("per, which is bin or keV, belongs to columns: deposited, and to these only")


def _axis(model: schema.AxisModel | None, count: int) -> Axis:
    """Evenly spaced energies [keV]."""
    return np.arange(count) * 1.0 if model is None else model.first + model.step * np.arange(count)


def _read_csv(path: Path, numbered: bool) -> tuple[Axis, Axis, Matrix]:
    """Energies of the first column, those of the first line where they are `numbered`, and the values."""
    try:
        with path.open(newline="", encoding="utf-8") as file:
            lines = [line for line in csv.reader(file) if line]
    except OSError as error:
        raise InputError(f"the file cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise InputError("the file is not UTF-8 text") from None
    if len(lines) < 2:
        raise InputError("a response matrix needs a line with the names of its columns, and lines with numbers")
    head = [_number(cell, 1, i + 2) for i, cell in enumerate(lines[0][1:])] if numbered else []
    for i, line in enumerate(lines[1:], start=2):
        if len(line) != len(lines[0]):
            raise InputError(f"line {i} has {len(line)} columns, the first one {len(lines[0])}")
    values = np.array([[_number(cell, i, j) for j, cell in enumerate(line, 1)] for i, line in enumerate(lines[1:], 2)])
    return values[:, 0], np.array(head), values[:, 1:]


def _number(cell: str, line: int, column: int) -> float:
    """A cell as a number."""
    try:
        return float(cell)
    except ValueError:
        raise InputError(f"{cell.strip()!r} in line {line}, column {column} is not a number") from None


def _read_array(name: str, folder: Path) -> np.ndarray:
    """A .npy file, or a dataset of an HDF5 file."""
    inside = re.fullmatch(r"(.+\.(?:h5|hdf5)):(/.+)", name, re.IGNORECASE)
    path = folder / (inside.group(1) if inside else name)
    if not inside and path.suffix.lower() != ".npy":
        raise InputError("a response matrix is a .csv or .npy file, or a dataset such as file.h5:/path")
    if not path.is_file():
        raise InputError("there is no such file")
    try:
        values = _read_hdf5(path, inside.group(2)) if inside else load_numpy(path)
    except InputError:
        raise
    except (ValueError, EOFError, OSError):
        raise InputError("the file is damaged, or of another kind than its name says") from None
    if not isinstance(values, np.ndarray) or values.dtype.kind not in "uif":
        raise InputError("the file holds no array of numbers")
    return values.astype(np.float64)


def _read_hdf5(path: Path, name: str) -> np.ndarray:
    """A dataset of an HDF5 file."""
    import h5py  # noqa: PLC0415 - only where there is such a file

    with h5py.File(path, "r") as file:
        found = file.get(name)
        if not isinstance(found, h5py.Dataset):
            raise InputError(f"there is no dataset {name}")
        return found[()]
