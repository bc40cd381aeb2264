"""Pickles of NAF and SAX-NeRF: poses and grid. Only arrays and plain values are read; nothing in them is run."""

import pickle
from pathlib import Path
from typing import Any

import numpy as np

from phantomgen.geometry.conversions.naf import from_naf
from phantomgen.importers.r2_gaussian import FolderGeometry
from spectra.errors import Error, InputError

_ALLOWED = {
    (module, name)
    for module in ("numpy.core.multiarray", "numpy._core.multiarray", "numpy._core.numeric", "numpy")
    for name in ("_reconstruct", "scalar", "ndarray", "dtype", "_frombuffer")
} | {("_codecs", "encode")}


class _ArraysOnly(pickle.Unpickler):
    """Unpickler that makes arrays of numpy and nothing else."""

    def find_class(self, module: str, name: str) -> Any:
        """Return a function or a class that a pickle names.

        Parameters
        ----------
        module, name : where it is

        Returns
        -------
        the function or class

        Raises
        ------
        pickle.UnpicklingError
            When it is not part of an array.
        """
        if (module, name) not in _ALLOWED:
            raise pickle.UnpicklingError(f"it names {module}.{name}")
        return super().find_class(module, name)


def read_naf(path: Path) -> Any:
    """Read what a pickle holds.

    Parameters
    ----------
    path : of the pickle

    Returns
    -------
    arrays and plain values

    Raises
    ------
    InputError
        When the file cannot be read, or holds anything else.
    """
    try:
        with path.open("rb") as file:
            return _ArraysOnly(file).load()
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from None
    except pickle.UnpicklingError as error:
        raise InputError(f"{path} holds more than arrays and numbers, which is not read ({error})") from None
    except Exception:
        raise InputError(f"{path} cannot be read: it is no pickle") from None


def read_naf_geometry(path: Path) -> FolderGeometry:
    """Read the poses and the grid of a pickle.

    Parameters
    ----------
    path : of the pickle

    Returns
    -------
    poses of the views for training, then of those for validation; grid

    Raises
    ------
    InputError
        When the file cannot be read, holds anything but arrays and plain values, or lacks a key.
    """
    values = read_naf(path)
    try:
        angles = [np.asarray(values[part]["angles"], dtype=np.float64) for part in ("train", "val") if part in values]
        geometry, grid = from_naf(values, np.concatenate(angles))
    except (TypeError, KeyError, ValueError) as error:
        said = str(error) if isinstance(error, Error) else "it must be a mapping with train and val, each with angles"
        raise InputError(f"{path}: {said}") from None
    return FolderGeometry(geometry, len(angles[0]), grid)
