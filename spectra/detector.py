"""Photon-counting detectors: which part of the photons of each energy every channel counts.

The detector here is ideal: a photon that the sensor absorbs is counted once, in the channel its energy belongs to.
Rows of a response need not sum to the absorption efficiency in general (charge sharing counts a photon twice), so
nothing downstream may normalise them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from spectra.energies import Energies
from spectra.errors import InputError
from spectra.materials import Material


@dataclass(frozen=True)
class Channel:
    """One counter, open for energies from `lower` up to but not including `upper` [keV]."""

    name: str
    lower: float
    upper: float


@dataclass(frozen=True)
class Detector:
    """Channels behind one sensor.

    Parameters
    ----------
    channels : counters in ascending order of energy; the last one has no upper limit in fact
    material : of the sensor
    thickness : of the sensor [mm]
    """

    channels: tuple[Channel, ...]
    material: Material
    thickness: float

    @classmethod
    def photon_counting(
        cls, thresholds: Sequence[float], top: float, material: Material | str = "CdTe", thickness: float = 1.6
    ) -> "Detector":
        """Disjoint channels ``bin0``, ``bin1``, ... between thresholds.

        Parameters
        ----------
        thresholds : lower limit of each channel, ascending [keV]
        top : highest energy of the source, its tube voltage [keV]
        material : of the sensor, or a formula with a known density
        thickness : of the sensor [mm]
        """
        limits = [float(t) for t in thresholds]
        _check_thresholds(limits, float(top))
        if not 0 < thickness < np.inf:
            raise InputError(f"the sensor thickness must be positive and finite, got {thickness:g} mm")
        sensor = Material(material, composition=material) if isinstance(material, str) else material
        channels = tuple(Channel(f"bin{i}", a, b) for i, (a, b) in enumerate(pairwise([*limits, float(top)])))
        return cls(channels, sensor, float(thickness))

    def __len__(self) -> int:
        return len(self.channels)

    @property
    def thresholds(self) -> tuple[float, ...]:
        """Lower limit of each channel [keV]."""
        return tuple(channel.lower for channel in self.channels)

    @property
    def names(self) -> tuple[str, ...]:
        """Channel names."""
        return tuple(channel.name for channel in self.channels)

    @property
    def breaks(self) -> tuple[float, ...]:
        """Energies where a response is not smooth [keV]: thresholds, and K edges of the sensor between them."""
        edges = self.material.k_edges(self.channels[0].lower, self.channels[-1].upper)
        return tuple(sorted({*self.thresholds, *edges}))

    def absorption(self, energy: Float[np.ndarray, " energy"]) -> Float[np.ndarray, " energy"]:
        """Part of the photons that the sensor absorbs, 1 - exp(-mu t)."""
        return -np.expm1(-self.thickness * self.material.attenuation(energy))

    def response(self, energies: Energies) -> Float[np.ndarray, "channel energy"]:
        """Counts per photon of each bin.

        A bin that a threshold cuts counts in proportion to its part above the threshold: snap grids to `breaks`.
        """
        uppers = [channel.upper for channel in self.channels[:-1]]
        limits = np.array([*self.thresholds, np.inf]), np.array([*uppers, np.inf])
        low, high = energies.edges[:-1], energies.edges[1:]
        overlap = [
            (np.minimum(high, upper) - np.maximum(low, lower)) / (high - low)
            for lower, upper in zip(limits[0][:-1], limits[1], strict=True)
        ]
        return np.clip(np.stack(overlap), 0.0, 1.0) * self.absorption(energies.nodes)


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
