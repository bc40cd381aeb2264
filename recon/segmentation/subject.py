"""Input of a segmentation: the volumes of a run, its Gaussians where it has them, basis functions and spectrum."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from phantomgen.geometry.voxel_grid import Grid
from recon.gaussians.model import GaussianModel, Gaussians
from recon.readouts.spectrum import detected_spectrum
from recon.runs.read_run import dataset_name, open_model
from spectra.basis.basis import Basis
from spectra.transmission import Transmission


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
    stored = open_model(folder)
    model = stored.model if isinstance(stored.model, GaussianModel) else None
    volumes = stored.model.volume(stored.grid)
    return Subject.of(volumes, stored.grid, stored.basis, stored.transmission, model, dataset_name(folder))
