"""Spectral model of a dataset: source, channels and basis functions."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float

from phantomgen.dataset.beam_profile import StoredProfile
from spectra.basis.basis import Basis
from spectra.detector.counters import above_thresholds, between_thresholds
from spectra.detector.dead_time import DeadTime, corrected_spread
from spectra.detector.detector import AnyDetector
from spectra.detector.pile_up import PileUp, PulseResponse, PulseSpectra
from spectra.energy.bin_split import split_bins
from spectra.errors import InputError
from spectra.materials.material import Material
from spectra.source.source import Source
from spectra.transmission import Transmission


@dataclass(frozen=True, eq=False)
class Spectra:
    """Spectral model: all energy data that a reconstructor may use.

    Parameters
    ----------
    energy : mean energy of each bin [keV]
    edges : bin edges [keV]
    source : incident photons per pixel and view at the panel centre, per bin
    response : counts per photon
    basis : raw basis functions
    basis_values : the basis functions at `energy`, as stored
    channels : channel names
    lower, upper : limits of each channel [keV]
    units : of the counts: ``counts``, or ``keV`` where a detector sums up energies
    variance : what a photon adds to the variance of the signal; None where photons are counted, and it is the response
    profile : how the open beam differs over the panel, None where it does not
    dead_time : of the pixels; None where every event is recorded. Then `weights` are events, and counts are fewer
    pulses : heights of the pulses of photons, where they pile up and their heights add; else None
    cumulative : whether each channel counts all photons above its lower limit, also those of the channels above it
    """

    energy: Float[np.ndarray, " energy"]
    edges: Float[np.ndarray, " energy_plus_1"]
    source: Float[np.ndarray, " energy"]
    response: Float[np.ndarray, "channel energy"]
    basis: Basis
    basis_values: Float[np.ndarray, "basis energy"]
    channels: tuple[str, ...]
    lower: Float[np.ndarray, " channel"]
    upper: Float[np.ndarray, " channel"]
    units: str = "counts"
    variance: Float[np.ndarray, "channel energy"] | None = None
    profile: StoredProfile | None = None
    dead_time: DeadTime | None = None
    pulses: PulseResponse | None = None
    cumulative: bool = False

    @classmethod
    def of(cls, source: Source, detector: AnyDetector, basis: Basis, bins: int = 128) -> "Spectra":
        """Create the spectral model of a source and a detector.

        Parameters
        ----------
        source, detector, basis : of the scan
        bins : number of energy bins, to which edges and thresholds add some

        Returns
        -------
        the spectral model, without a profile and without dead time
        """
        grid = source.grid(detector.lowest, bins, (*detector.breaks, *basis.breaks))
        energies, photons = source.sampled(grid)
        return cls(
            energy=energies.nodes,
            edges=energies.edges,
            source=photons,
            response=detector.response(energies),
            basis=basis,
            basis_values=basis.evaluate(energies.nodes),
            channels=detector.names,
            lower=np.array([channel.lower for channel in detector.channels]),
            upper=np.array([channel.upper for channel in detector.channels]),
            units=detector.units,
            variance=detector.variance(energies),
        )

    @property
    def weights(self) -> Float[np.ndarray, "channel energy"]:
        """Counts per bin and channel with nothing in the beam, source x response."""
        return self.source * self.response

    @property
    def effective_energy(self) -> Float[np.ndarray, " channel"]:
        """Mean energy of what each channel counts in the open beam [keV]; NaN for a channel that counts nothing."""
        counts = self.weights.sum(axis=1)
        return np.where(counts > 0, self.weights @ self.energy, np.nan) / np.where(counts > 0, counts, 1.0)

    @property
    def quantum(self) -> Float[np.ndarray, " channel"]:
        """Variance over mean of the open beam of each channel: 1 for counts, else a photon's part in the signal."""
        signal = self.weights.sum(axis=1)
        if self.variance is None:
            return np.ones_like(signal)
        return (self.source * self.variance).sum(axis=1) / np.where(signal > 0, signal, 1.0)

    def check(self) -> None:
        """Check that heights of pulses belong to these thresholds and to a dead time.

        Raises
        ------
        InputError
            When they are not.
        """
        if self._pile_up is None and self.pulses is not None:
            raise InputError("heights of pulses that pile up need a dead time")

    def above_thresholds(self) -> "Spectra":
        """Return the model of counters that count all photons above their thresholds.

        Returns
        -------
        the spectral model, `cumulative`
        """
        upper = np.full_like(self.upper, self.upper[-1])
        return replace(self, response=above_thresholds(self.response), upper=upper, cumulative=True)

    def between_thresholds(self) -> "Spectra":
        """Return the model of the channels between thresholds, the inverse of `above_thresholds`.

        Returns
        -------
        the spectral model, not `cumulative`
        """
        upper = np.append(self.lower[1:], self.upper[-1])
        response = np.maximum(between_thresholds(self.response), 0.0)  # rounding errors of a difference
        return replace(self, response=response, upper=upper, cumulative=False)

    def events(self, counts: Float[np.ndarray, "channel row column"]) -> Float[np.ndarray, "channel row column"]:
        """Return the counts that pixels without dead time would have had.

        Parameters
        ----------
        counts : recorded counts of one frame

        Returns
        -------
        corrected counts; `counts` where every event is recorded
        """
        if self.dead_time is None:
            return counts
        between = between_thresholds(counts) if self.cumulative else counts
        if self._pile_up is None:
            events = self.dead_time.corrected(between)
        else:
            events = self._pile_up.corrected(np.asarray(between, dtype=np.float64), self._pulse_spectra)
        return above_thresholds(events) if self.cumulative else events

    @property
    def highest_load(self) -> float:
        """Events per dead time up to which counts can be corrected; infinite where every event is recorded."""
        if self.dead_time is None:
            return np.inf
        return self.dead_time.highest_load if self._pile_up is None else self._pile_up.highest_load

    def recorded(self, events: Float[np.ndarray, "channel row column"]) -> Float[np.ndarray, "channel row column"]:
        """Return the mean counts that pixels record of events, the inverse of `events`.

        Parameters
        ----------
        events : mean events of one frame, between thresholds

        Returns
        -------
        mean recorded counts between thresholds; `events` where every event is recorded
        """
        if self.dead_time is None:
            return events
        if self._pile_up is None:
            return self.dead_time.recorded(events)
        pulses = self._pile_up.pulses(np.asarray(events, dtype=np.float64), self._pulse_spectra)
        return self._pile_up.recorded(pulses)

    def spread(self, events: Float[np.ndarray, "channel row column"]) -> Float[np.ndarray, "channel row column"]:
        """Return the variance of corrected counts over their mean; see `spectra.detector.dead_time.corrected_spread`.

        Parameters
        ----------
        events : mean events of one frame, between thresholds

        Returns
        -------
        variance over mean of what `events` gives; 1 where every event is recorded
        """
        if self.dead_time is None:
            return np.ones_like(events)
        return corrected_spread(np.asarray(events, dtype=np.float64), self.recorded, self.dead_time)

    @cached_property
    def _pile_up(self) -> PileUp | None:
        """How heights of pulses add; None where they do not."""
        if self.dead_time is None or self.pulses is None:
            return None
        return PileUp(self.dead_time, tuple(self.lower.tolist()), self.pulses.edges)

    @cached_property
    def _pulse_spectra(self) -> PulseSpectra:
        """Pulse heights behind water."""
        assert self.pulses is not None
        water = Material("water", 1.0, "H2O").attenuation(self.energy)
        return PulseSpectra.behind_water(self.source * self.pulses.response, water)

    def transmission(self) -> Transmission:
        """Create the transmission from line integrals of the basis, then lengths in the profile, to expected counts.

        Returns
        -------
        the transmission
        """
        parts = [] if self.profile is None else [self.profile.attenuation]
        return Transmission.from_spectrum(self.weights, np.concatenate([self.basis_values, *parts]), self.channels)


def in_basis(spectra: "Spectra", basis: Basis) -> "Spectra":
    """Replace the basis functions; source and detector do not change.

    Parameters
    ----------
    spectra : as stored
    basis : functions to use; bins are cut where one has an edge, so that expected counts are continuous in its energy

    Returns
    -------
    the spectral model
    """
    split = split_bins(spectra.edges, spectra.energy, basis.breaks)
    parents = split.parents
    profile, pulses = spectra.profile, spectra.pulses
    if pulses is not None:
        pulses = PulseResponse(pulses.edges, pulses.response[:, parents])
    if profile is not None:
        profile = StoredProfile(profile.names, profile.lengths, profile.attenuation[:, parents])
    return replace(
        spectra,
        energy=split.nodes,
        edges=split.edges,
        source=spectra.source[parents] * split.shares,
        response=np.ascontiguousarray(spectra.response[:, parents]),
        basis=basis,
        basis_values=basis.evaluate(split.nodes),
        variance=None if spectra.variance is None else spectra.variance[:, parents],
        profile=profile,
        pulses=pulses,
    )
