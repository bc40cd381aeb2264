"""Opening of dataset files, the version of their format, and names of their groups."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import h5py

from phantomgen.dataset.compression import check_readable
from phantomgen.dataset.layout import SCHEMA, SCHEMA_VERSION, text_of
from spectra.errors import DatasetError, Error

DETECTOR = "/entry/instrument/detector"
FLAT, DARK = "/entry/instrument/flat/data", "/entry/instrument/dark/data"


def open_file(path: Path) -> h5py.File:
    """Open a file for reading and check that it is a dataset of a readable version.

    Parameters
    ----------
    path : the file

    Returns
    -------
    open file

    Raises
    ------
    DatasetError
        When the file is missing, no dataset, or of a newer version.
    """
    scene = path.suffix.lower() in {".yaml", ".yml"}
    if path.is_dir():
        raise DatasetError(f"{path} is a folder and no dataset")
    if not path.is_file():
        hint = f"; `phantomgen make {path}` makes one of a scene file or preset" if scene or not path.suffix else ""
        raise DatasetError(f"there is no dataset {path}{hint}")
    if scene:
        raise DatasetError(f"{path} is no dataset: `phantomgen make {path}` makes one of a scene file")
    try:
        file = h5py.File(path, "r")
    except OSError as error:
        reason = "it is cut off" if "truncated" in str(error) else "it is damaged or not an HDF5 file"
        raise DatasetError(f"{path} cannot be read: {reason}") from None
    try:
        _check_version(file, path)
        check_readable(file, f"{DETECTOR}/data")
    except Error:
        file.close()
        raise
    return file


@contextmanager
def damaged_file(path: Path) -> Iterator[None]:
    """Convert HDF5 errors on unreadable bytes to one sentence; a context manager.

    Parameters
    ----------
    path : the file, for the message

    Yields
    ------
    nothing

    Raises
    ------
    DatasetError
        When a part of the file cannot be read.
    """
    try:
        yield
    except OSError:
        raise DatasetError(f"{path} is damaged: a part of it cannot be read") from None


def _check_version(file: h5py.File, path: Path) -> None:
    """Refuse other files and newer major versions; a newer minor version only adds things."""
    if text_of(file.attrs.get("schema", "")) != SCHEMA:
        raise DatasetError(f"{path} is not a {SCHEMA} dataset: its root has no attribute schema={SCHEMA!r}")
    version = text_of(file.attrs.get("schema_version", ""))
    major = version.split(".")[0]
    if not major.isdigit():
        raise DatasetError(f"{path} states no schema version")
    if int(major) > SCHEMA_VERSION[0]:
        known = ".".join(map(str, SCHEMA_VERSION))
        raise DatasetError(
            f"{path} has schema version {version}, this program knows {known}: update it by "
            "'pip install --upgrade spectral-ct'"
        )
