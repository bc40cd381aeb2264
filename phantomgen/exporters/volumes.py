"""Volumes for other programs: which formats there are, and files that appear when they are complete."""

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

import numpy as np
from jaxtyping import Shaped

from phantomgen.geometry.voxel_grid import Grid
from phantomgen.runtime.disk import complete_file
from spectra.errors import InputError

FORMATS = {".vti": "vti", ".nii": "nifti", ".nii.gz": "nifti"}  # suffix: module that writes it


@dataclass(frozen=True, eq=False)
class Volumes:
    """Named volumes on one grid.

    Parameters
    ----------
    grid : the voxels
    values : by their names
    about : what they are and their unit, in one line
    """

    grid: Grid
    values: dict[str, Shaped[np.ndarray, "z y x"]]
    about: str

    def __post_init__(self) -> None:
        for name, values in self.values.items():
            if values.shape != self.grid.shape:
                raise InputError(f"the volume {name} has shape {values.shape}, its grid {self.grid.shape}")

    def __repr__(self) -> str:
        return f"Volumes({', '.join(self.values)}: {' x '.join(map(str, self.grid.shape))} voxels)"


def basis_volumes(grid: Grid, names: tuple[str, ...], volumes: Shaped[np.ndarray, "basis z y x"]) -> Volumes:
    """Create the volumes of basis functions.

    Parameters
    ----------
    grid : the voxels
    names : names of the basis functions
    volumes : coefficients [1/mm], (basis, z, y, x)

    Returns
    -------
    the volumes
    """
    values = {name: volume.astype(np.float32) for name, volume in zip(names, volumes, strict=True)}
    return Volumes(grid, values, f"basis coefficients [1/mm]: {', '.join(names)}")


def suffix_of(path: Path, known: dict[str, str] = FORMATS) -> str:
    """Return the suffix of a file that can be written, in lower case.

    Parameters
    ----------
    path : the file
    known : suffixes that can be written

    Returns
    -------
    the suffix

    Raises
    ------
    InputError
        When it is none of those known.
    """
    for suffix in sorted(known, key=len, reverse=True):
        if path.name.lower().endswith(suffix) and len(path.name) > len(suffix):
            return suffix
    raise InputError(f"{path}: the suffix says the format, one of {', '.join(known)}")


def writer_of(path: Path) -> Callable[[Path, Volumes], None]:
    """Return the function that writes the format of a file's suffix.

    Parameters
    ----------
    path : the file

    Returns
    -------
    function of path and volumes

    Raises
    ------
    InputError
        When the suffix is unknown.
    NotInstalledError
        When the format needs a package that is not there.
    """
    return import_module(f"phantomgen.exporters.{FORMATS[suffix_of(path)]}").writer()


def write_volumes(path: Path, volumes: Volumes) -> None:
    """Write volumes in the format of the suffix; an existing file is replaced.

    Parameters
    ----------
    path : the file
    volumes : the volumes

    Raises
    ------
    InputError, NotInstalledError
        See `writer_of`.
    StorageError
        When the file system refuses; then no file is left.
    """
    write = writer_of(path)
    with complete_file(path, suffix_of(path)) as beside:
        write(beside, volumes)
