"""Several sources in one scan: dual-source CT, and tube voltages that are switched from view to view.

Channels belong to one source each. The source of the scan is the sum of all, and the response of a channel counts its
own source's share of the photons of each energy, so that expected counts are source x response as in every other scan.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from spectra.detector import Channel, Detector
from spectra.energies import Energies
from spectra.errors import InputError
from spectra.source import Source

_SAME_LINE = 1e-6  # keV
EnergyArray = Float[np.ndarray, " energy"]


@dataclass(frozen=True, eq=False)
class SeveralSources:
    """A detector that counts the photons of each source apart, as if it had the channels of a detector for each.

    Parameters
    ----------
    labels : of the sources; channels are called ``<source>_<channel>``
    sources : photons of each source
    detectors : what counts the photons of each
    """

    labels: tuple[str, ...]
    sources: tuple[Source, ...]
    detectors: tuple[Detector, ...]

    def __post_init__(self) -> None:
        if not len(self.labels) == len(self.sources) == len(self.detectors) > 0:
            raise InputError(
                f"{len(self.labels)} labels, {len(self.sources)} sources, {len(self.detectors)} detectors do not match"
            )

    def __len__(self) -> int:
        return sum(len(detector) for detector in self.detectors)

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Channels of the first source, then those of the second, and so on."""
        pairs = zip(self.labels, self.detectors, strict=True)
        return tuple(replace(c, name=f"{label}_{c.name}") for label, detector in pairs for c in detector.channels)

    @property
    def names(self) -> tuple[str, ...]:
        """Channel names."""
        return tuple(channel.name for channel in self.channels)

    @property
    def groups(self) -> tuple[int, ...]:
        """Which source each channel belongs to."""
        return tuple(g for g, detector in enumerate(self.detectors) for _ in detector.channels)

    @property
    def breaks(self) -> tuple[float, ...]:
        """Energies where a response is not smooth [keV]."""
        return tuple(sorted({edge for detector in self.detectors for edge in detector.breaks}))

    def response(self, energies: Energies) -> Float[np.ndarray, "channel energy"]:
        """Counts per photon of all sources together, for each bin."""
        photons = np.stack([source.sampled(energies)[1] for source in self.sources])
        total = photons.sum(axis=0)
        shares = np.divide(photons, total, out=np.zeros_like(photons), where=total > 0)
        return np.concatenate(
            [share * detector.response(energies) for share, detector in zip(shares, self.detectors, strict=True)]
        )


def added(sources: Sequence[Source]) -> Source:
    """One source with the photons of all; its density jumps and bends wherever one of theirs does."""
    corners = np.unique(np.concatenate([source.energy for source in sources]))
    left, right = (
        sum((_limit(s, corners, side) for s in sources), np.zeros_like(corners)) for side in ("left", "right")
    )
    jumps = left != right
    jumps[:1] = jumps[-1:] = False
    left[:1], right[-1:] = right[:1], left[-1:]
    lines = np.concatenate([source.line_energy for source in sources])
    order = np.argsort(lines, kind="stable")
    photons = np.concatenate([source.line_photons for source in sources])[order]
    first = np.diff(lines[order], prepend=-np.inf) > _SAME_LINE
    maximum = max(source.maximum for source in sources)
    ends = {source.maximum for source in sources if source.maximum < maximum}
    return Source(
        energy=np.repeat(corners, 1 + jumps),
        density=np.stack([left, right], axis=1)[np.stack([jumps, np.ones_like(jumps)], axis=1)],
        line_energy=lines[order][first],
        line_photons=np.bincount(np.cumsum(first) - 1, photons, first.sum()),
        maximum=maximum,
        breaks=tuple(sorted({edge for source in sources for edge in source.breaks} | ends)),
    )


def _limit(source: Source, energy: EnergyArray, side: str) -> EnergyArray:
    """Density just below (`left`) or just above (`right`) energies; 0 outside the corners."""
    x, y = source.energy, source.density
    if len(x) < 2:
        return np.zeros_like(energy)
    at = np.searchsorted(x, energy, side="left" if side == "left" else "right")
    inside = (at > 0) & (at < len(x))
    at = np.clip(at, 1, len(x) - 1)
    width = x[at] - x[at - 1]
    part = (energy - x[at - 1]) / np.where(width > 0, width, 1.0)
    return np.where(inside, y[at - 1] + part * (y[at] - y[at - 1]), 0.0)
