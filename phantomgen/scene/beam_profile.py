"""Beam profile: absorption by the bowtie filter and the heel effect in each pixel."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float


@runtime_checkable
class Absorber(Protocol):
    """Interface of an absorber: anything with an attenuation curve."""

    def attenuation(self, energy: Float[np.ndarray, " energy"]) -> Float[np.ndarray, " energy"]:
        """Compute the attenuation at given energies.

        Parameters
        ----------
        energy : photon energies [keV]

        Returns
        -------
        attenuation [1/mm], or without unit where lengths have none
        """
        ...


@dataclass(frozen=True, eq=False)
class Profile:
    """Beam profile: sheets of absorber, with their lengths relative to the central ray.

    Parameters
    ----------
    names : of the parts
    absorbers : their attenuation curves
    lengths : on the ray to each pixel, beyond those on the central ray [mm]; may be negative
    """

    names: tuple[str, ...]
    absorbers: tuple[Absorber, ...]
    lengths: Float[np.ndarray, "part row column"]

    def attenuation(self, energy: Float[np.ndarray, " energy"]) -> Float[np.ndarray, "part energy"]:
        """Compute the attenuation curves of all parts.

        Parameters
        ----------
        energy : photon energies [keV]

        Returns
        -------
        curves [1/mm], (part, energy)
        """
        return np.stack([absorber.attenuation(energy) for absorber in self.absorbers])
