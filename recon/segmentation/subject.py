"""What is segmented: the volumes of a run, its Gaussians where it has them, and the physics behind both."""

import json
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
from jaxtyping import Float

from phantomgen.geometry.voxel_grid import Grid
from recon.gaussians.model import Gaussians
from recon.runs.run_folder import MODEL, SCAN, open_run, open_scan
from spectra.basis.basis import Basis
from spectra.errors import DatasetError
from spectra.transmission import Transmission

_ENERGIES = np.arange(5.0, 400.0, 0.05)  # where nodes are looked for [keV]


@dataclass(frozen=True, eq=False)
class Subject:
    """A run that can be segmented.

    Parameters
    ----------
    volumes : coefficients [1/mm]
    grid : their voxels
    basis : their functions of energy
    energy, weights : detected spectrum in the open beam, energies [keV] and photons
    gaussians : the model; None for methods on voxels
    dataset : file name of the scan; empty where the run does not say
    """

    volumes: Float[np.ndarray, "basis z y x"]
    grid: Grid
    basis: Basis
    energy: Float[np.ndarray, " node"]
    weights: Float[np.ndarray, " node"]
    gaussians: Gaussians | None = None
    dataset: str = ""


def open_subject(folder: Path) -> Subject:
    """Read a run folder of any method.

    Raises
    ------
    DatasetError
        When it is not one, when it is incomplete, or when another version wrote it.
    """
    dataset = _dataset_name(folder)
    if (folder / MODEL).is_file():
        run = open_run(folder)
        names = run.gaussians.basis_names
        volumes, grid, basis, transmission = run.gaussians.volume(run.grid), run.grid, run.basis, run.transmission
        gaussians = run.gaussians
    elif (folder / "volumes.h5").is_file():
        if not (folder / SCAN).is_file():
            raise DatasetError(f"{folder} has no {SCAN}, which older versions did not write: run recon fit again")
        volumes, names = _read_volumes(folder / "volumes.h5")
        scan = open_scan(folder, len(names))
        grid, basis, transmission, gaussians = scan.grid, scan.basis, scan.transmission, None
    else:
        raise DatasetError(
            f"{folder} is not a run folder: it has neither {MODEL} nor volumes.h5; make one by recon fit"
        )
    if basis.names[: len(names)] != names or volumes.shape[1:] != grid.shape:
        raise DatasetError(
            f"{folder} does not fit together: {SCAN} describes another basis or grid than the result has"
        )
    basis = Basis(basis.functions[: len(names)], basis.reference_energy)
    return Subject(volumes, grid, basis, *detected_spectrum(basis, transmission), gaussians, dataset)


def detected_spectrum(
    basis: Basis, transmission: Transmission
) -> tuple[Float[np.ndarray, " node"], Float[np.ndarray, " node"]]:
    """Energies [keV] and photons of the nodes of all channels; energies are those whose basis values are nearest."""
    values = basis.evaluate(_ENERGIES)
    columns = transmission.columns[: len(basis)]
    scale = np.linalg.norm(columns, axis=0)
    distances = np.linalg.norm(values[:, None, :] - columns[:, :, None], axis=0) / scale[:, None]
    return _ENERGIES[distances.argmin(axis=1)], transmission.weights


def _dataset_name(folder: Path) -> str:
    """File name of the scan that a run was made from."""
    try:
        return str(json.loads((folder / "metrics.json").read_text(encoding="utf-8")).get("dataset", ""))
    except (OSError, ValueError, AttributeError):
        return ""


def _read_volumes(path: Path) -> tuple[Float[np.ndarray, "basis z y x"], tuple[str, ...]]:
    """Volumes of a run and the names of their bases."""
    try:
        with h5py.File(path) as file:
            return np.asarray(file["basis/data"]), tuple(np.asarray(file["basis/basis_name"].asstr()))  # type: ignore[union-attr]
    except (OSError, KeyError) as error:
        raise DatasetError(f"{path} cannot be read as volumes that recon fit writes ({error})") from error
