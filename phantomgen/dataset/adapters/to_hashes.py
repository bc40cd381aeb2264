"""Hashes of what a dataset holds, by which a scan can be told from another one.

They cover values and shapes, not bytes of a file: neither compression nor the version of the format changes them, and
the number of threads does not either.
"""

from collections.abc import Iterator
from hashlib import sha256
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from phantomgen.dataset.checks.door import array_at, frame_at
from phantomgen.dataset.file import DETECTOR, FLAT
from phantomgen.dataset.reader import Dataset, open_dataset

Contents = dict[str, tuple[np.ndarray | h5py.Dataset, ...]]


def contents(dataset: Dataset) -> Contents:
    """Return the arrays of a scan that results depend on.

    Parameters
    ----------
    dataset : open, with a truth

    Returns
    -------
    ``counts``, ``flats``, ``truth_basis`` and ``truth_fractions``, still in the file; ``stated_spectra``, which are
    edges of the energy bins, open-beam counts per bin and channel, and basis functions; ``stated_poses``, which are
    source, centre of the panel and both steps; ``stated_views``, which are exposures, training and test views

    Raises
    ------
    DatasetError
        When the file lacks one of the arrays.
    """
    spectra, geometry = dataset.spectra, dataset.geometry
    return {
        "counts": (array_at(dataset.file, f"{DETECTOR}/data"),),
        "flats": (array_at(dataset.file, FLAT),),
        "stated_spectra": (spectra.edges, spectra.weights, spectra.basis_values),
        "stated_poses": (geometry.source, geometry.panel_center, geometry.column_step, geometry.row_step),
        "stated_views": (dataset.exposure, dataset.splits["train"], dataset.splits["test"]),
        "truth_basis": (array_at(dataset.file, "/truth/basis/data"),),
        "truth_fractions": (array_at(dataset.file, "/truth/fractions"),),
    }


def array_hashes(path: Path) -> dict[str, dict[str, Any]]:
    """Compute hashes of the arrays of a scan that results depend on.

    Parameters
    ----------
    path : dataset with a truth

    Returns
    -------
    by the names of `contents`: ``shapes``, and ``sha256`` of them and of the values, each as 8 bytes, lowest first

    Raises
    ------
    DatasetError
        When the file is no dataset, is damaged, or lacks one of the arrays.
    """
    with open_dataset(path) as dataset:
        return {name: _digest(arrays) for name, arrays in contents(dataset).items()}


def _digest(arrays: tuple[np.ndarray | h5py.Dataset, ...]) -> dict[str, Any]:
    """Shapes, and SHA-256 of them and of the values."""
    shapes = [list(array.shape) for array in arrays]
    found = sha256(str(shapes).encode())
    for array in arrays:
        wide = "<f8" if array.dtype.kind == "f" else "<i8"
        for part in _parts(array):
            found.update(np.ascontiguousarray(part, wide).tobytes())
    return {"shapes": shapes, "sha256": found.hexdigest()}


def _parts(array: np.ndarray | h5py.Dataset) -> Iterator[np.ndarray]:
    """Values along the first axis, piece by piece."""
    if isinstance(array, np.ndarray):
        yield array
        return
    for number in range(array.shape[0]):
        yield frame_at(array, number)
