"""The detected spectrum of a scan, from the spectral model of its record."""

import numpy as np
from jaxtyping import Float

from spectra.basis.basis import Basis
from spectra.transmission import Transmission

_ENERGIES = np.arange(5.0, 400.0, 0.05)  # keV; energies among which those of the nodes are found


def detected_spectrum(
    basis: Basis, transmission: Transmission
) -> tuple[Float[np.ndarray, " node"], Float[np.ndarray, " node"]]:
    """Return the nodes of the spectral model of all channels as one spectrum.

    Parameters
    ----------
    basis : basis functions
    transmission : spectral model, whose first columns are the values of the basis functions at its nodes; of the first
        functions alone, where others were not reconstructed

    Returns
    -------
    energies [keV] and photons of the nodes; an energy is that at which the values of the basis functions are nearest
    """
    columns = transmission.columns[: len(basis)]
    values = basis.evaluate(_ENERGIES)[: len(columns)]
    scale = np.linalg.norm(columns, axis=0)
    distances = np.linalg.norm(values[:, None, :] - columns[:, :, None], axis=0) / scale[:, None]
    return _ENERGIES[distances.argmin(axis=1)], transmission.weights
