"""Inputs and results of the transport kernel."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

LOWEST = 1.0  # keV; a photon below leaves its energy where it is


class Beam(NamedTuple):
    """Photons that leave the source towards the panel, evenly over its area.

    Parameters
    ----------
    frames : of each view and module, source, vector to the first pixel's centre, column step and row step [mm]
    views : cumulative part of the photons of each view
    rows, columns : pixels of a module
    energy : of each bin [keV]
    spectrum : cumulative part of the photons of each bin
    lengths : path lengths in what shapes the beam [mm]; no parts for an even beam
    shape : attenuation of these parts at the energy of each bin [1/mm]
    """

    frames: Float[np.ndarray, "view module 4 3"]
    views: Float[np.ndarray, " view"]
    rows: int
    columns: int
    energy: Float[np.ndarray, " bin"]
    spectrum: Float[np.ndarray, " bin"]
    lengths: Float[np.ndarray, "part row all_columns"]
    shape: Float[np.ndarray, "part bin"]


class Medium(NamedTuple):
    """Materials on voxels; where a voxel holds several, they are mixed.

    Parameters
    ----------
    fractions : part of each voxel that each material fills
    low : corner of the voxels (z, y, x) [mm]
    spacing : edges of a voxel (z, y, x) [mm]
    """

    fractions: Float[np.ndarray, "material z y x"]
    low: Float[np.ndarray, " 3"]
    spacing: Float[np.ndarray, " 3"]


class Crossings(NamedTuple):
    """What happens to photons, by material and energy; tables begin at energy 0 and x = 0.

    Parameters
    ----------
    step : of energies [keV]
    total : attenuation [1/mm]
    photoelectric, compton : cumulative parts of the collisions that are photoelectric, and photoelectric or Compton
    transferred : energy transfer coefficient mu_tr [1/mm]
    largest : largest attenuation of all materials at an energy [1/mm]
    air : mass energy-absorption coefficient of air [mm^2/g]
    x_step : of momentum transfer x = sin(theta / 2) / lambda [1/Angstrom]
    incoherent : scattering function of x over that of free electrons
    coherent : integral of the squared form factor over x^2 from 0 on
    """

    step: float
    total: Float[np.ndarray, "material energy"]
    photoelectric: Float[np.ndarray, "material energy"]
    compton: Float[np.ndarray, "material energy"]
    transferred: Float[np.ndarray, "material energy"]
    largest: Float[np.ndarray, " energy"]
    air: Float[np.ndarray, " energy"]
    x_step: float
    incoherent: Float[np.ndarray, "material x"]
    coherent: Float[np.ndarray, "material x"]


class Probes(NamedTuple):
    """Cylinders along z.

    Parameters
    ----------
    centre : of each (x, y) [mm]
    radius : of each [mm]
    ends : lowest and highest z of each [mm]
    """

    centre: Float[np.ndarray, "probe 2"]
    radius: Float[np.ndarray, " probe"]
    ends: Float[np.ndarray, "probe 2"]


class Deposits(NamedTuple):
    """What photons leave.

    Parameters
    ----------
    voxels : energy in each voxel [keV]
    energy : in each probe [keV]
    air : air kerma x volume of each probe, in keV mm^3/g
    ends : energy that photons had at first, that they had where they left the voxels, and that they lost there [keV]
    """

    voxels: Float[np.ndarray, "z y x"]
    energy: Float[np.ndarray, " probe"]
    air: Float[np.ndarray, " probe"]
    ends: Float[np.ndarray, " 3"]

    @classmethod
    def empty(cls, medium: Medium, probes: Probes) -> "Deposits":
        """Return nothing left.

        Parameters
        ----------
        medium : voxels
        probes : cylinders

        Returns
        -------
        zeros
        """
        count = len(probes.radius)
        return cls(np.zeros(medium.fractions.shape[1:]), np.zeros(count), np.zeros(count), np.zeros(3))
