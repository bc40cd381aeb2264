"""Opening of dataset files, the version of their format, and names of their groups."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

import h5py

from phantomgen.dataset.checks.digest import check_seal, seal
from phantomgen.dataset.checks.door import DAMAGE, readable
from phantomgen.dataset.compression import check_readable
from phantomgen.dataset.layout import SCHEMA, SCHEMA_VERSION, text_of
from phantomgen.runtime.disk import one_sentence
from spectra.errors import DatasetError, Error

DETECTOR = "/entry/instrument/detector"
FLAT, DARK = "/entry/instrument/flat/data", "/entry/instrument/dark/data"
COUNTERS = f"{DETECTOR}/counters"
CUMULATIVE, DISJOINT = "cumulative", "bins"  # counts above thresholds, and between them


def open_file(path: Path, part: Literal["entry", "truth"] = "entry") -> h5py.File:
    """Open a file for reading and check that it is a dataset of a readable version, and as it was written.

    Parameters
    ----------
    path : the file
    part : what is read of it, whose digests are compared

    Returns
    -------
    open file

    Raises
    ------
    DatasetError
        When the file is missing, no dataset, of a newer version, or damaged.
    """
    check_is_dataset(path)
    try:
        file = h5py.File(path, "r")
    except OSError as error:
        reason = "it is cut off" if "truncated" in str(error) else "it is damaged or not an HDF5 file"
        raise DatasetError(f"{path} cannot be read: {reason}") from None
    try:
        _check_version(file, path)
        check_seal(file, part)
        with readable(file, f"{DETECTOR}/data"):
            check_readable(file, f"{DETECTOR}/data")
    except BaseException:
        file.close()
        raise
    return file


def check_is_dataset(path: Path) -> None:
    """Refuse a name that cannot be a dataset, before the file is opened.

    Parameters
    ----------
    path : the file

    Raises
    ------
    DatasetError
        When there is no file, or it is a folder or a scene.
    """
    scene = path.suffix.lower() in {".yaml", ".yml"}
    if path.is_dir():
        raise DatasetError(f"{path} is a folder and no dataset")
    if not path.is_file():
        hint = f"; `phantomgen make {path}` makes one of a scene file or preset" if scene or not path.suffix else ""
        raise DatasetError(f"there is no dataset {path}{hint}")
    if scene:
        raise DatasetError(f"{path} is no dataset: `phantomgen make {path}` makes one of a scene file")


def is_dataset(path: Path) -> bool:
    """Return whether a file is a dataset, or a damaged HDF5 file, which may have been one.

    Parameters
    ----------
    path : an HDF5 file by its first bytes

    Returns
    -------
    False for HDF5 files of other programs
    """
    try:
        with h5py.File(path, "r") as file:
            return text_of(file.attrs.get("schema", "")) == SCHEMA
    except DAMAGE:
        return True


DATASET = ("a dataset", is_dataset)  # what may be replaced by one


def seal_file(path: Path) -> None:
    """Write the digests of a dataset as it is now, after an edit on purpose.

    Parameters
    ----------
    path : the dataset

    Raises
    ------
    DatasetError
        When the file is no dataset.
    StorageError
        When it cannot be written.
    """
    check_is_dataset(path)
    with one_sentence(path), h5py.File(path, "r+") as file:
        _check_version(file, path)
        seal(file)


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
    except Error:
        raise
    except (OSError, RuntimeError):
        raise DatasetError(f"{path} is damaged: a part of it cannot be read") from None


def _check_version(file: h5py.File, path: Path) -> None:
    """Refuse other files and newer major versions; a newer minor version only adds things."""
    with readable(file, "/"):
        schema, version = (text_of(file.attrs.get(name, "")) for name in ("schema", "schema_version"))
    if schema != SCHEMA:
        raise DatasetError(f"{path} is not a {SCHEMA} dataset: its root has no attribute schema={SCHEMA!r}")
    major = version.split(".")[0]
    if not major.isdigit():
        raise DatasetError(f"{path} states no schema version")
    if int(major) > SCHEMA_VERSION[0]:
        known = ".".join(map(str, SCHEMA_VERSION))
        raise DatasetError(
            f"{path} has schema version {version}, this program knows {known}: update it by "
            "'pip install --upgrade spectral-ct'"
        )
