"""Reading a run folder of any method: volumes, and Gaussians where the method has them."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import h5py
import numpy as np
from jaxtyping import Float32

from phantomgen.dataset.checks.door import DAMAGE, group_at, value_at
from phantomgen.geometry.voxel_grid import Grid
from recon.gaussians.divided.model_file import load_model
from recon.gaussians.model import GaussianModel
from recon.runs.run_folder import MODEL, SCAN, VOLUMES, open_run, open_scan
from recon.voxel.model import Voxels
from spectra.basis.basis import Basis
from spectra.errors import DatasetError, Error
from spectra.transmission import Transmission


@dataclass(frozen=True, eq=False)
class StoredRun:
    """Result of a run, as read from its folder.

    Parameters
    ----------
    folder : run folder
    grid, basis_names : of the volumes
    volumes : basis coefficients [1/mm]
    gaussians : the fitted Gaussians; None where the method has none
    dataset : name of the file that was reconstructed; empty where the folder does not state it
    """

    folder: Path
    grid: Grid
    basis_names: tuple[str, ...]
    volumes: Float32[np.ndarray, "basis z y x"]
    gaussians: GaussianModel | None
    dataset: str

    @property
    def name(self) -> str:
        """Name of the folder."""
        return self.folder.resolve().name

    def on(self, grid: Grid) -> Float32[np.ndarray, "basis z y x"]:
        """Compute the volumes on another grid.

        Parameters
        ----------
        grid : any grid

        Returns
        -------
        basis coefficients [1/mm]: means over the voxels where the run has Gaussians, else interpolated linearly
        """
        if grid == self.grid:
            return self.volumes
        model = self.gaussians or Voxels(self.volumes, self.grid, self.basis_names)
        return model.volume(grid).astype(np.float32)


class StoredVolumes(NamedTuple):
    """Content of ``volumes.h5``.

    Parameters
    ----------
    grid : grid of the volumes
    basis_names : names of the basis functions
    values : coefficients [1/mm]
    """

    grid: Grid
    basis_names: tuple[str, ...]
    values: Float32[np.ndarray, "basis z y x"]


@dataclass(frozen=True, eq=False)
class StoredModel:
    """Result of a run that has values on any grid, with what its coefficients mean.

    Parameters
    ----------
    model : Gaussians, or volumes between whose voxels values are interpolated
    grid : grid of the dataset
    basis : basis functions of the model
    transmission : spectral model of a pixel at the panel's centre, at exposure 1
    """

    model: GaussianModel | Voxels
    grid: Grid
    basis: Basis
    transmission: Transmission


def open_model(folder: Path) -> StoredModel:
    """Read a run folder of any method with volumes; volumes of Gaussians are not computed.

    Parameters
    ----------
    folder : run folder

    Returns
    -------
    model and record of the scan

    Raises
    ------
    DatasetError
        When it is no run folder, when it is incomplete, or when another version wrote it.
    """
    check_run_folder(folder)
    model: GaussianModel | Voxels
    if (folder / MODEL).is_file():
        run = open_run(folder)
        model, grid, basis, transmission = run.gaussians, run.grid, run.basis, run.transmission
    else:
        if not (folder / SCAN).is_file():
            raise DatasetError(f"{folder} has no {SCAN}, which older versions did not write: run recon fit again")
        stored = read_volumes(folder / VOLUMES)
        model = Voxels(stored.values, stored.grid, stored.basis_names)
        scan = open_scan(folder, len(stored.basis_names))
        grid, basis, transmission = scan.grid, scan.basis, scan.transmission
    names = model.basis_names
    if basis.names[: len(names)] != names or (isinstance(model, Voxels) and model.values.shape[1:] != grid.shape):
        raise DatasetError(
            f"{folder} does not fit together: {SCAN} describes another basis or grid than the result has"
        )
    own = Basis(basis.functions[: len(names)], basis.reference_energy)
    return StoredModel(model, grid, own, transmission)


def check_run_folder(folder: Path) -> None:
    """Refuse a folder without the files of a run, before anything is read.

    Parameters
    ----------
    folder : run folder

    Raises
    ------
    DatasetError
        When there is no such folder, or neither volumes nor a model are in it.
    """
    if not folder.is_dir():
        raise DatasetError(f"there is no run folder {folder}; make one by recon fit")
    if not ((folder / VOLUMES).is_file() or (folder / MODEL).is_file()):
        raise DatasetError(f"{folder} is not a run folder: it has neither {VOLUMES} nor {MODEL}; make one by recon fit")


def read_run(folder: Path) -> StoredRun:
    """Read a run folder; volumes of an interrupted fit, which are not in its folder, are computed.

    Parameters
    ----------
    folder : run folder

    Returns
    -------
    the result

    Raises
    ------
    DatasetError
        When it is not one, or what is in it was damaged or written by another version.
    """
    check_run_folder(folder)
    volumes, model = folder / VOLUMES, folder / MODEL
    gaussians = load_model(model) if model.is_file() else None
    if volumes.is_file():
        grid, names, values = read_volumes(volumes)
    else:
        run = open_run(folder)
        grid, names, values = run.grid, run.gaussians.basis_names, run.gaussians.volume(run.grid)
    if gaussians is not None and gaussians.basis_names != names:
        raise DatasetError(
            f"{folder}: {MODEL} has the bases {', '.join(gaussians.basis_names)}, {VOLUMES} has {', '.join(names)}: "
            "they are not of one run"
        )
    return StoredRun(folder, grid, names, values, gaussians, dataset_name(folder))


def read_volumes(path: Path) -> StoredVolumes:
    """Read the volumes of a run.

    Parameters
    ----------
    path : ``volumes.h5`` of a run folder

    Returns
    -------
    grid, names of the basis functions, and coefficients

    Raises
    ------
    DatasetError
        When the file was damaged, or is not what ``recon fit`` writes.
    """
    try:
        with h5py.File(path, "r") as file:
            group, place = group_at(file, "basis"), group_at(file, "grid")
            shape, spacing, origin = (value_at(place, name) for name in ("shape", "spacing", "origin"))
            grid = Grid(tuple(map(int, shape)), tuple(map(float, spacing)), tuple(map(float, origin)))  # type: ignore[arg-type]
            names = tuple(map(str, np.ravel(value_at(group, "basis_name"))))
            values = np.asarray(value_at(group, "data")).astype(np.float32)
    except Error:
        raise
    except DAMAGE as error:
        raise DatasetError(f"{path} cannot be read as what recon fit writes there ({error})") from None
    if values.shape != (len(names), *grid.shape):
        raise DatasetError(f"{path}: /basis/data has shape {values.shape}, expected {(len(names), *grid.shape)}")
    if not np.isfinite(values).all():
        raise DatasetError(f"{path}: /basis/data holds a value that is not a number; run recon fit again")
    return StoredVolumes(grid, names, values)


def dataset_name(folder: Path) -> str:
    """Return the file name, without its folder, of the dataset that a run was made from.

    Parameters
    ----------
    folder : run folder

    Returns
    -------
    file name; empty where the folder does not state it
    """
    try:
        content = json.loads((folder / "metrics.json").read_text(encoding="utf-8"))
        return Path(content["dataset"]).name
    except (OSError, ValueError, KeyError, TypeError):
        return ""


def find_dataset(name: str, folders: Sequence[Path]) -> Path | None:
    """Find a dataset beside a run or in the current folder.

    Parameters
    ----------
    name : file name of the dataset
    folders : run folders

    Returns
    -------
    path; None where there is none
    """
    places = [*(folder.resolve().parent for folder in folders), Path()]
    return next((place / name for place in places if name and (place / name).is_file()), None)
