"""What bowtie and heel do to the beam in each pixel."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from jaxtyping import Float


class Absorber(Protocol):
    """Anything with an attenuation curve."""

    def attenuation(self, energy: Float[np.ndarray, " energy"]) -> Float[np.ndarray, " energy"]:
        """Attenuation [1/mm], or without unit where lengths have none, at `energy` [keV]."""
        ...


@dataclass(frozen=True, eq=False)
class Profile:
    """Sheets of absorber, with their lengths relative to the central ray.

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
        """Curves of all parts [1/mm]."""
        return np.stack([absorber.attenuation(energy) for absorber in self.absorbers])
