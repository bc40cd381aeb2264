"""Several sources in one scan: dual-source CT, and tube voltages that are switched from view to view.

Channels belong to one source each. The source of the scan is the sum of all, and the response of a channel counts its
own source's share of the photons of each energy, so that expected counts are source x response as in every other scan.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from spectra.detector.detector import AnyDetector
from spectra.energy.grid import Energies
from spectra.errors import InputError
from spectra.source.source import Source

_SAME_LINE = 1e-6  # keV
EnergyArray = Float[np.ndarray, " energy"]


@dataclass(frozen=True, eq=False)
class MultiSource(AnyDetector):
    """Detector that measures the photons of each source separately, as if each source had a detector of its own.

    Parameters
    ----------
    channels : those of the first source, then those of the second, and so on
    labels : names of the sources
    sources : photons of each source
    detectors : what measures the photons of each
    """

    labels: tuple[str, ...]
    sources: tuple[Source, ...]
    detectors: tuple[AnyDetector, ...]

    @classmethod
    def of(cls, sources: Mapping[str, Source], detectors: Sequence[AnyDetector]) -> "MultiSource":
        """Create channels ``<source>_<channel>`` of named sources, with a detector for each.

        Parameters
        ----------
        sources : sources by name
        detectors : one for each source

        Returns
        -------
        the detector

        Raises
        ------
        InputError
            When there are not as many detectors as sources.
        """
        if len(sources) != len(detectors):
            raise InputError(f"{len(sources)} sources need as many detectors, got {len(detectors)}")
        pairs = zip(sources, detectors, strict=True)
        channels = tuple(replace(c, name=f"{name}_{c.name}") for name, detector in pairs for c in detector.channels)
        return cls(channels, tuple(sources), tuple(sources.values()), tuple(detectors))

    @property
    def groups(self) -> tuple[int, ...]:
        """Index of the source that each channel belongs to."""
        return tuple(g for g, detector in enumerate(self.detectors) for _ in detector.channels)

    @property
    def units(self) -> str:
        """Unit of what is measured."""
        return self.detectors[0].units

    @property
    def lowest(self) -> float:
        """Energy below which no photon is measured [keV]."""
        return min(detector.lowest for detector in self.detectors)

    @property
    def breaks(self) -> tuple[float, ...]:
        """Energies where a response is not smooth [keV]."""
        return tuple(sorted({edge for detector in self.detectors for edge in detector.breaks}))

    @property
    def model_warnings(self) -> tuple[str, ...]:
        """Sentences about what the models of the detectors leave out and should not."""
        return tuple(dict.fromkeys(sentence for detector in self.detectors for sentence in detector.model_warnings))

    def response(self, energies: Energies) -> Float[np.ndarray, "channel energy"]:
        """Compute the mean signal of each channel per photon of all sources together, for each bin.

        Parameters
        ----------
        energies : energy bins

        Returns
        -------
        signal per photon, (channel, energy), in `units`
        """
        shares = self._shares(energies)
        return np.concatenate([s * d.response(energies) for s, d in zip(shares, self.detectors, strict=True)])

    def variance(self, energies: Energies) -> Float[np.ndarray, "channel energy"] | None:
        """Compute the variance that a photon of each bin adds to the signal.

        Parameters
        ----------
        energies : energy bins

        Returns
        -------
        variance per photon, (channel, energy); None for counts, where it equals the response
        """
        variances = [detector.variance(energies) for detector in self.detectors]
        pairs = zip(self._shares(energies), variances, strict=True)
        parts = [share * variance for share, variance in pairs if variance is not None]
        return np.concatenate(parts) if len(parts) == len(variances) else None

    def _shares(self, energies: Energies) -> Float[np.ndarray, "source energy"]:
        """Part of the photons of each bin that each source sends."""
        photons = np.stack([source.sampled(energies)[1] for source in self.sources])
        total = photons.sum(axis=0)
        return np.divide(photons, total, out=np.zeros_like(photons), where=total > 0)


def added(sources: Sequence[Source]) -> Source:
    """Add the photons of several sources to one source.

    Its density jumps and bends wherever one of theirs does.

    Parameters
    ----------
    sources : sources to add

    Returns
    -------
    one source
    """
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
