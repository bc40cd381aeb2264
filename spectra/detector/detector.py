"""Detectors: what every channel measures of a photon of each energy.

`AnyDetector` is what all kinds have in common; `Detector` is the ideal photon-counting one: a photon that the sensor
absorbs is counted once, in the channel its energy belongs to. Rows of a response need not sum to the absorption
efficiency in general (charge sharing counts a photon twice), so nothing downstream may normalise them.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from spectra.energy.grid import Energies
from spectra.errors import InputError
from spectra.materials.material import Material


@dataclass(frozen=True)
class Channel:
    """Channel of a detector: one counter, open from `lower` up to but not including `upper`.

    Parameters
    ----------
    name : of the channel
    lower, upper : limits of the energy [keV]
    """

    name: str
    lower: float
    upper: float


@dataclass(frozen=True)
class AnyDetector(ABC):
    """Base class of detectors: measured signal of each channel per photon of each energy.

    Parameters
    ----------
    channels : in ascending order of energy
    """

    channels: tuple[Channel, ...]

    def __len__(self) -> int:
        return len(self.channels)

    @property
    def units(self) -> str:
        """Unit of what is measured."""
        return "counts"

    @property
    def thresholds(self) -> tuple[float, ...]:
        """Lower limit of each channel [keV]."""
        return tuple(channel.lower for channel in self.channels)

    @property
    def names(self) -> tuple[str, ...]:
        """Channel names."""
        return tuple(channel.name for channel in self.channels)

    @property
    def lowest(self) -> float:
        """Energy below which no photon is measured [keV]."""
        return self.channels[0].lower

    @property
    def lowest_scattered(self) -> float:
        """Energy below which no photon is measured that has lost energy in the object [keV]."""
        return self.lowest

    @property
    @abstractmethod
    def breaks(self) -> tuple[float, ...]:
        """Energies where a response is not smooth [keV]."""

    @abstractmethod
    def response(self, energies: Energies) -> Float[np.ndarray, "channel energy"]:
        """Compute the mean signal of each channel per photon of each bin.

        Parameters
        ----------
        energies : energy bins

        Returns
        -------
        signal per photon, (channel, energy), in `units`
        """

    def variance(self, energies: Energies) -> Float[np.ndarray, "channel energy"] | None:
        """Compute the variance that a photon of each bin adds to the signal.

        Parameters
        ----------
        energies : energy bins

        Returns
        -------
        variance per photon, (channel, energy); None for counts, where it equals the response
        """
        del energies
        return None

    @property
    def model_warnings(self) -> tuple[str, ...]:
        """Sentences about what the model of the detector leaves out and should not."""
        return ()


@dataclass(frozen=True)
class Detector(AnyDetector):
    """Ideal photon-counting detector: counters behind one sensor.

    Parameters
    ----------
    channels : counters in ascending order of energy; the last one has no upper limit in fact
    material : of the sensor
    thickness : of the sensor [mm]
    """

    material: Material
    thickness: float

    @classmethod
    def photon_counting(
        cls, thresholds: Sequence[float], top: float, material: Material | str = "CdTe", thickness: float = 1.6
    ) -> "Detector":
        """Create disjoint channels ``bin0``, ``bin1``, ... between thresholds.

        Parameters
        ----------
        thresholds : lower limit of each channel, ascending [keV]
        top : highest energy of the source, its tube voltage [keV]
        material : of the sensor, or a formula with a known density
        thickness : of the sensor [mm]

        Returns
        -------
        the detector
        """
        sensor = Material(material, composition=material) if isinstance(material, str) else material
        return cls(channels_between(thresholds, top), sensor, float(thickness))

    def __post_init__(self) -> None:
        if not 0 < self.thickness < np.inf:
            raise InputError(f"the sensor thickness must be positive and finite, got {self.thickness:g} mm")

    @property
    def breaks(self) -> tuple[float, ...]:
        """Energies where a response is not smooth [keV]: thresholds, and K edges of the sensor between them."""
        edges = self.material.k_edges(self.channels[0].lower, self.channels[-1].upper)
        return tuple(sorted({*self.thresholds, *edges}))

    def absorption(self, energy: Float[np.ndarray, " energy"]) -> Float[np.ndarray, " energy"]:
        """Compute the fraction of the photons that the sensor absorbs, 1 - exp(-mu t).

        Parameters
        ----------
        energy : photon energies [keV]

        Returns
        -------
        fraction of each energy
        """
        return absorbed(self.material, self.thickness, energy)

    def response(self, energies: Energies) -> Float[np.ndarray, "channel energy"]:
        """Compute the counts per photon of each bin.

        A bin that a threshold cuts counts in proportion to its part above the threshold: snap grids to `breaks`.

        Parameters
        ----------
        energies : energy bins; snap them to `breaks`

        Returns
        -------
        counts per photon, (channel, energy)
        """
        uppers = [channel.upper for channel in self.channels[:-1]]
        limits = np.array([*self.thresholds, np.inf]), np.array([*uppers, np.inf])
        low, high = energies.edges[:-1], energies.edges[1:]
        overlap = [
            (np.minimum(high, upper) - np.maximum(low, lower)) / (high - low)
            for lower, upper in zip(limits[0][:-1], limits[1], strict=True)
        ]
        return np.clip(np.stack(overlap), 0.0, 1.0) * self.absorption(energies.nodes)


def channels_between(thresholds: Sequence[float], top: float) -> tuple[Channel, ...]:
    """Create channels ``bin0``, ``bin1``, ... between thresholds.

    Parameters
    ----------
    thresholds : lower limit of each channel, ascending [keV]
    top : upper limit of the last channel [keV]

    Returns
    -------
    the channels

    Raises
    ------
    InputError
        When thresholds do not ascend, are below 1 keV, or reach `top`.
    """
    limits = [float(t) for t in thresholds]
    _check_thresholds(limits, float(top))
    return tuple(Channel(f"bin{i}", a, b) for i, (a, b) in enumerate(pairwise([*limits, float(top)])))


def absorbed(
    material: Material, thickness: float, energy: Float[np.ndarray, " energy"]
) -> Float[np.ndarray, " energy"]:
    """Compute the fraction of the photons that a sheet absorbs, 1 - exp(-mu t).

    Parameters
    ----------
    material : of the sheet
    thickness : of the sheet [mm]
    energy : photon energies [keV]

    Returns
    -------
    fraction of each energy
    """
    return -np.expm1(-thickness * material.attenuation(energy))


def _check_thresholds(thresholds: list[float], top: float) -> None:
    """Refuse channels that are empty or out of order."""
    if not thresholds:
        raise InputError("a photon-counting detector needs at least one threshold")
    if not all(np.isfinite(t) and t >= 1 for t in thresholds):
        raise InputError(f"thresholds must be finite and at least 1 keV, got {thresholds}")
    for i, (lower, upper) in enumerate(pairwise(thresholds)):
        if upper <= lower:
            raise InputError(f"thresholds must ascend, but bin{i} would reach from {lower:g} to {upper:g} keV")
    for i, lower in enumerate(thresholds):
        if lower >= top:
            raise InputError(
                f"channel bin{i} starts at {lower:g} keV and sees no photons: the source ends at {top:g} keV"
            )
