"""Data folders of R2-Gaussian: poses and grid."""

import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from phantomgen.geometry.conversions.r2_gaussian import from_r2_gaussian
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from spectra.errors import Error, InputError

_LENGTHS = ("DSD", "DSO", "sDetector", "sVoxel", "offOrigin", "offDetector")


class FolderGeometry(NamedTuple):
    """Poses and grid of a data folder.

    Parameters
    ----------
    geometry : views for training, then for tests
    train : number of views for training
    grid : the voxels
    """

    geometry: Geometry
    train: int
    grid: Grid


def read_r2_geometry(folder: Path) -> FolderGeometry:
    """Read the poses and the grid of a folder.

    Parameters
    ----------
    folder : with ``meta_data.json``; lengths are multiplied by its ``unit_mm`` where `phantomgen export` wrote it

    Returns
    -------
    poses and grid; in mm if the file's lengths are

    Raises
    ------
    InputError
        When the file cannot be read, lacks a key, or holds something else in it.
    """
    path = folder / "meta_data.json"
    try:
        meta = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from None
    except ValueError:
        raise InputError(f"{path} cannot be read: it is not JSON") from None
    if not isinstance(meta, dict) or not isinstance(meta.get("scanner"), dict):
        raise InputError(f"{path}: the key scanner is missing, or is no mapping")
    angles = [_angles(path, meta, name) for name in ("proj_train", "proj_test")]
    unit = meta["scanner"].get("unit_mm", 1.0)
    if not isinstance(unit, int | float) or not 0 < unit < np.inf:
        raise InputError(f"{path}: scanner.unit_mm must be a positive number, got {unit!r}")
    try:
        scanner = meta["scanner"]
        scaled = {name: np.multiply(scanner[name], unit).tolist() for name in _LENGTHS if name in scanner}
        geometry, grid = from_r2_gaussian({**scanner, **scaled}, np.concatenate(angles))
    except (Error, TypeError, ValueError) as error:
        raise InputError(f"{path}: {error}") from None
    return FolderGeometry(geometry, len(angles[0]), grid)


def _angles(path: Path, meta: dict[str, Any], name: str) -> np.ndarray:
    """Angles of a list of views."""
    entries = meta.get(name, [])
    try:
        angles = np.array([float(entry["angle"]) for entry in entries])
    except (TypeError, KeyError, ValueError):
        raise InputError(f"{path}: {name} must be a list of views, each with an angle in radians") from None
    if not len(angles) and name == "proj_train":
        raise InputError(f"{path}: {name} lists no views")
    return angles
