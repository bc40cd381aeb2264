"""Input of a segmentation: the volumes of a run, its Gaussians where it has them, basis functions and spectrum."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from phantomgen.geometry.voxel_grid import Grid
from recon.gaussians.model import GaussianModel, Gaussians
from recon.runs.read_run import VOLUMES, dataset_name, read_volumes
from recon.runs.run_folder import MODEL, SCAN, open_run, open_scan
from spectra.basis.basis import Basis
from spectra.errors import DatasetError
from spectra.transmission import Transmission

_ENERGIES = np.arange(5.0, 400.0, 0.05)  # keV; energies among which those of the nodes are found


@dataclass(frozen=True, eq=False)
class Subject:
    """Results of a run that can be segmented.

    Parameters
    ----------
    volumes : coefficients [1/mm]
    grid : grid of the volumes
    basis : basis functions of the volumes
    energy, weights : detected spectrum in the open beam, energies [keV] and photons
    gaussians : model, without the planes that divide its Gaussians; None for methods on voxels
    dataset : file name of the scan; empty where the run does not state it
    divided : whether planes divide the Gaussians of the model, so that `gaussians` approximates it
    """

    volumes: Float[np.ndarray, "basis z y x"]
    grid: Grid
    basis: Basis
    energy: Float[np.ndarray, " node"]
    weights: Float[np.ndarray, " node"]
    gaussians: Gaussians | None = None
    dataset: str = ""
    divided: bool = False

    @classmethod
    def of(
        cls,
        volumes: Float[np.ndarray, "basis z y x"],
        grid: Grid,
        basis: Basis,
        transmission: Transmission,
        model: GaussianModel | None,
        dataset: str = "",
    ) -> "Subject":
        """Make a subject of the results of a reconstruction.

        Parameters
        ----------
        volumes : coefficients [1/mm]
        grid : grid of the volumes
        basis : basis functions of the volumes
        transmission : spectral model of all channels
        model : Gaussians; None for methods on voxels
        dataset : file name of the scan

        Returns
        -------
        the subject
        """
        plain, divided = (None, False) if model is None else (model.plain(), model.SIGNED)
        return cls(volumes, grid, basis, *detected_spectrum(basis, transmission), plain, dataset, divided)


def open_subject(folder: Path) -> Subject:
    """Read a run folder of any method.

    Parameters
    ----------
    folder : run folder

    Returns
    -------
    results of the run

    Raises
    ------
    DatasetError
        When it is no run folder, when it is incomplete, or when another version wrote it.
    """
    dataset = dataset_name(folder)
    if (folder / MODEL).is_file():
        run = open_run(folder)
        names = run.gaussians.basis_names
        volumes, grid, basis, transmission = run.gaussians.volume(run.grid), run.grid, run.basis, run.transmission
        model = run.gaussians
    elif (folder / VOLUMES).is_file():
        if not (folder / SCAN).is_file():
            raise DatasetError(f"{folder} has no {SCAN}, which older versions did not write: run recon fit again")
        stored = read_volumes(folder / VOLUMES)
        names, volumes = stored.basis_names, stored.values
        scan = open_scan(folder, len(names))
        grid, basis, transmission, model = scan.grid, scan.basis, scan.transmission, None
    else:
        raise DatasetError(f"{folder} is not a run folder: it has neither {MODEL} nor {VOLUMES}; make one by recon fit")
    if basis.names[: len(names)] != names or volumes.shape[1:] != grid.shape:
        raise DatasetError(
            f"{folder} does not fit together: {SCAN} describes another basis or grid than the result has"
        )
    basis = Basis(basis.functions[: len(names)], basis.reference_energy)
    return Subject.of(volumes, grid, basis, transmission, model, dataset)


def detected_spectrum(
    basis: Basis, transmission: Transmission
) -> tuple[Float[np.ndarray, " node"], Float[np.ndarray, " node"]]:
    """Return the nodes of the spectral model of all channels as one spectrum.

    Parameters
    ----------
    basis : basis functions
    transmission : spectral model, whose first columns are the values of the basis functions at its nodes

    Returns
    -------
    energies [keV] and photons of the nodes; an energy is that at which the values of the basis functions are nearest
    """
    values = basis.evaluate(_ENERGIES)
    columns = transmission.columns[: len(basis)]
    scale = np.linalg.norm(columns, axis=0)
    distances = np.linalg.norm(values[:, None, :] - columns[:, :, None], axis=0) / scale[:, None]
    return _ENERGIES[distances.argmin(axis=1)], transmission.weights
