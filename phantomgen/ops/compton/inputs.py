"""Inputs of the scatter kernels: points and energies."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

# Least width of an energy bin after scatter [keV], for those of spectral lines: far below the resolution of detectors,
# and wide enough for differences of tables.
NARROW = 1e-3


class Points(NamedTuple):
    """Where photons are scattered.

    Parameters
    ----------
    place : of each point [mm]
    strength : electrons times r_e^2 / 2 [mm^2]
    photons : of each energy bin that come there, per solid angle of the source [1/sr]
    """

    place: Float[np.ndarray, "point 3"]
    strength: Float[np.ndarray, " point"]
    photons: Float[np.ndarray, "point bin"]


class Energies(NamedTuple):
    """What happens to photons of any energy.

    Parameters
    ----------
    edges : of the bins before scatter [keV]
    step : spacing of the tables, which start at 0 and end above the highest energy [keV]
    attenuation : of each material [1/mm]
    measured : signal per photon, integrated from 0 on [keV]
    """

    edges: Float[np.ndarray, " edge"]
    step: float
    attenuation: Float[np.ndarray, "energy material"]
    measured: Float[np.ndarray, "energy group"]
