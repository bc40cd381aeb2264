"""Hashes of what a dataset holds, by which a scan can be told from another one."""

from hashlib import sha256
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from phantomgen.dataset.file import DETECTOR, FLAT
from phantomgen.dataset.layout import array_at
from phantomgen.dataset.reader import open_dataset

HASHED = {
    "counts": f"{DETECTOR}/data",
    "flats": FLAT,
    "stated_channels": "/entry/spectra/channel",
    "stated_basis": "/entry/spectra/basis",
    "stated_poses": "/entry/geometry/panel_center",
    "truth_basis": "/truth/basis/data",
    "truth_fractions": "/truth/fractions",
}


def array_hashes(path: Path) -> dict[str, dict[str, Any]]:
    """Compute hashes of the arrays of a scan that results depend on.

    Parameters
    ----------
    path : dataset with a truth

    Returns
    -------
    by the names of `HASHED`: ``dtype``, ``shape``, and ``sha256`` of both and of the bytes of the values

    Raises
    ------
    DatasetError
        When the file is no dataset, or lacks one of the arrays.
    """
    with open_dataset(path) as dataset:
        return {name: _digest(array_at(dataset.file, place)) for name, place in HASHED.items()}


def _digest(array: h5py.Dataset) -> dict[str, Any]:
    """Type, shape, and SHA-256 of both and of the values, read piece by piece."""
    found = sha256(f"{array.dtype.str} {array.shape}".encode())
    for part in array:
        found.update(np.ascontiguousarray(part).tobytes())
    return {"dtype": array.dtype.str, "shape": list(array.shape), "sha256": found.hexdigest()}
