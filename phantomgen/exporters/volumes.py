"""Volumes for other programs: which formats there are, and files that appear when they are complete."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

import numpy as np
from jaxtyping import Shaped

from phantomgen.dataset.truth import read_truth
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.runtime.disk import one_sentence
from spectra.errors import DatasetError, InputError

FORMATS = {".vti": "vti", ".nii": "nifti", ".nii.gz": "nifti"}  # suffix: module that writes it


@dataclass(frozen=True, eq=False)
class Volumes:
    """Volumes of one grid.

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


def true_volumes(path: Path, labels: bool = False) -> Volumes:
    """Basis volumes of a dataset's truth, or what fills most of each voxel.

    Parameters
    ----------
    path : of the dataset
    labels : 0 for the background, i + 1 for material i, in place of the bases

    Raises
    ------
    DatasetError
        When the dataset holds no truth, or is damaged.
    """
    truth = read_truth(path)
    if truth is None:
        raise DatasetError(f"{path} holds no truth to export")
    if labels:
        names = ", ".join(f"{i} {name}" for i, name in enumerate(truth.material_names, 1))
        return Volumes(truth.grid, {"labels": truth.labels}, f"materials: 0 background, {names}")
    return basis_volumes(truth.grid, truth.basis_names, truth.volumes)


def basis_volumes(grid: Grid, names: tuple[str, ...], volumes: Shaped[np.ndarray, "basis z y x"]) -> Volumes:
    """Volumes of basis functions [1/mm]."""
    values = {name: volume.astype(np.float32) for name, volume in zip(names, volumes, strict=True)}
    return Volumes(grid, values, f"basis coefficients [1/mm]: {', '.join(names)}")


def suffix_of(path: Path, known: dict[str, str] = FORMATS) -> str:
    """The suffix of a file that can be written, in lower case.

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
    """What writes the format that a suffix says.

    Raises
    ------
    InputError
        When the suffix is unknown.
    NotInstalledError
        When the format needs a package that is not there.
    """
    return import_module(f"phantomgen.io.{FORMATS[suffix_of(path)]}").writer()


def write_volumes(path: Path, volumes: Volumes) -> None:
    """Write the format that the suffix of `path` says; a file that is there is replaced.

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


@contextmanager
def complete_file(path: Path, suffix: str) -> Iterator[Path]:
    """A name with the same suffix beside `path`, which it is renamed to at the end."""
    beside = path.with_name(f"{path.name}.part{suffix}")
    try:
        with one_sentence(path):
            yield beside
            beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)
