"""Pile-up: pulses whose heights add while they overlap, so that two photons count as one of more energy.

Pulses are rectangles as long as the dead time. Of n pulses, x in a dead time, E is the height of one, and V the sum of
those that arrive in a dead time. A non-paralyzable pixel is busy for a dead time after a count, whose height is the sum
of all pulses in it: above a threshold T it records n / (1 + x) P(E + V >= T) counts. A paralyzable pixel counts each
rise of the signal, the sum of the pulses there, through the threshold: n (P(V < T) - P(E + V < T)) counts. Both record
as many counts above the lowest threshold as with dead time alone. Pulses below it neither count nor add.

Heights are known in groups a few keV wide. Going back from counts to pulses, those within a channel are distributed as
behind so much water as leaves as many pulses.

References
----------
Taguchi et al. 2010, Medical Physics 37, 3957, doi:10.1118/1.3429056, for pulses that pile up in non-paralyzable pixels;
Panjer 1981, ASTIN Bulletin 12, 22, doi:10.1017/S0515036100006796, for the distribution of sums
"""

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int

from spectra.detector.dead_time import DeadTime
from spectra.detector.detector import Detector, channels_between
from spectra.energy.grid import Energies
from spectra.errors import InputError
from spectra.ops.pile_up import Lattice, Load, Shapes, event_counts, recorded_counts

# Widest group of pulse heights; steps of their lattice, to simulate and to correct with [keV].
_WIDEST = 2.5
_STEP, _COARSE_STEP = 1.0, 2.0
# Water that leaves exp(-8) of the pulses and less causes no pile-up; so many spectra are tabulated up to there.
_DARKEST, _SPECTRA = 8.0, 33
# Pulses per dead time. Beyond, other channels than the last, or than the first, count next to nothing.
_HIGHEST_LOAD = {"nonparalyzable": 5.0, "paralyzable": 0.9}

PerEnergy = Float[np.ndarray, " energy"]
Groups = Float[np.ndarray, "*frame group row column"]
Counts = Float[np.ndarray, "*frame channel row column"]


def pulse_detector(detector: Detector) -> Detector:
    """Return a detector whose channels are the groups of pulse heights of another one.

    Parameters
    ----------
    detector : with the thresholds of the counters

    Returns
    -------
    the detector with channels at most a few keV wide, but for the last one, which stays whole
    """
    parts = [
        np.linspace(low, high, int(np.ceil((high - low) / _WIDEST)) + 1)[:-1]
        for low, high in pairwise(detector.thresholds)
    ]
    limits = [*map(float, np.concatenate([*parts, detector.thresholds[-1:]]))]
    return replace(detector, channels=channels_between(limits, detector.channels[-1].upper))


def edges_of(groups: Detector) -> Float[np.ndarray, " group_plus_1"]:
    """Return the limits of the groups of pulse heights.

    Parameters
    ----------
    groups : what `pulse_detector` makes of a detector

    Returns
    -------
    limits, ascending [keV]
    """
    return np.array([*groups.thresholds, groups.channels[-1].upper])


@dataclass(frozen=True, eq=False)
class PulseResponse:
    """Heights of the pulses of photons.

    Parameters
    ----------
    edges : of the groups of heights, ascending, thresholds among them [keV]
    response : pulses of each group per photon of each energy
    """

    edges: Float[np.ndarray, " group_plus_1"]
    response: Float[np.ndarray, "group energy"]

    @classmethod
    def of(cls, groups: Detector, energies: Energies) -> "PulseResponse":
        """Compute the pulses of a detector.

        Parameters
        ----------
        groups : what `pulse_detector` makes of it
        energies : bins

        Returns
        -------
        the pulses per photon of each bin
        """
        return cls(edges_of(groups), groups.response(energies))


@dataclass(frozen=True, eq=False)
class PileUp:
    """Pixels whose pulses pile up.

    Parameters
    ----------
    dead_time : of the pixels
    thresholds : lower limits of the channels [keV]
    edges : of the groups of pulse heights, ascending, thresholds among them [keV]

    Raises
    ------
    InputError
        When edges do not ascend from the lowest threshold, or a threshold is none of them.
    """

    dead_time: DeadTime
    thresholds: tuple[float, ...]
    edges: Float[np.ndarray, " group_plus_1"]

    def __post_init__(self) -> None:
        if not (
            set(self.thresholds) <= set(self.edges.tolist())
            and (np.diff(self.edges) > 0).all()
            and 0 < self.edges[0] == self.thresholds[0]
        ):
            raise InputError(
                f"limits of pulse heights must ascend, begin at the lowest threshold and hold all thresholds, "
                f"{', '.join(f'{t:g}' for t in self.thresholds)} keV; those from {self.edges[0]:g} to "
                f"{self.edges[-1]:g} keV do not"
            )

    @cached_property
    def channels(self) -> Int[np.ndarray, " group"]:
        """Channel of each group."""
        return np.searchsorted(self.thresholds, self.edges[:-1], side="right") - 1

    @property
    def starts(self) -> Int[np.ndarray, " channel_plus_1"]:
        """First group of each channel, and the number of groups."""
        return np.searchsorted(self.channels, np.arange(len(self.thresholds) + 1))

    def recorded(self, pulses: Groups) -> Counts:
        """Compute the mean recorded counts of each channel.

        Parameters
        ----------
        pulses : mean pulses of each group

        Returns
        -------
        mean recorded counts
        """
        rows = _pixels(pulses)
        return _images(recorded_counts(rows, self._load(rows.sum(axis=1)), self._lattice(_STEP)), pulses.shape)

    @property
    def highest_load(self) -> float:
        """Pulses per dead time up to which counts are corrected within 1 %, for the model of the dead time."""
        return _HIGHEST_LOAD[self.dead_time.model]

    def pulses(self, events: Counts, spectra: "PulseSpectra") -> Groups:
        """Distribute the events of each channel over its groups of heights, as behind water.

        Parameters
        ----------
        events : mean events of each channel
        spectra : pulse heights behind water

        Returns
        -------
        mean pulses of each group
        """
        rows, table = _pixels(events), spectra.shapes(self.starts)
        places = spectra.places(rows.sum(axis=1))
        row = np.minimum(places.astype(int), len(table) - 2)
        weight = (places - row)[:, None]
        shapes = (1 - weight) * table[row] + weight * table[row + 1]
        return _images(shapes * rows[:, self.channels], events.shape)

    def corrected(self, recorded: Counts, spectra: "PulseSpectra") -> Counts:
        """Compute the events of each channel from recorded counts.

        Parameters
        ----------
        recorded : recorded counts
        spectra : pulse heights behind water

        Returns
        -------
        events; exact where pulses within each channel are distributed as behind water
        """
        rows = _pixels(recorded)
        totals = np.maximum(_pixels(self.dead_time.corrected(recorded)).sum(axis=1), 0.0)
        shapes = Shapes(spectra.shapes(self.starts), spectra.places(totals), self.starts)
        return _images(
            event_counts(rows, totals, self._load(totals), self._lattice(_COARSE_STEP), shapes), recorded.shape
        )

    def _load(self, pulses: Float[np.ndarray, " pixel"]) -> Load:
        """Load of pixels with so many pulses."""
        return Load.of(self.dead_time.per_count * pulses, self.dead_time.model == "paralyzable")

    def _lattice(self, step: float) -> Lattice:
        """The groups on a lattice of at most `step` keV, and finer where the lowest threshold is low."""
        return Lattice.of(self.edges, self.thresholds, min(step, self.thresholds[0] / 2))


@dataclass(frozen=True, eq=False)
class PulseSpectra:
    """Pulse heights behind no water and behind more and more of it.

    Parameters
    ----------
    pulses : in each group, for ever more water
    """

    pulses: Float[np.ndarray, "water group"]

    @classmethod
    def behind_water(cls, pulses: Float[np.ndarray, "group energy"], attenuation: PerEnergy) -> "PulseSpectra":
        """Create the table.

        Parameters
        ----------
        pulses : in the open beam, per group of heights and energy of photons
        attenuation : of water [1/mm]

        Returns
        -------
        the table
        """
        # Steps of equal loss in the least attenuated energies, which are those that remain.
        softest = attenuation[pulses.sum(axis=0) > 0].min()
        lengths = np.linspace(0, _DARKEST / softest, _SPECTRA)
        return cls(np.exp(-lengths[:, None] * attenuation) @ pulses.T)

    def shapes(self, starts: Int[np.ndarray, " channel_plus_1"]) -> Float[np.ndarray, "water group"]:
        """Compute the part of each channel's pulses in each of its groups.

        Parameters
        ----------
        starts : first group of each channel, and the number of groups

        Returns
        -------
        parts, which sum to 1 in each channel; even ones where there are no pulses
        """
        sums = np.repeat(np.add.reduceat(self.pulses, starts[:-1], axis=1), np.diff(starts), axis=1)
        even = np.repeat(1 / np.diff(starts), np.diff(starts))
        return np.where(sums > 0, self.pulses / np.where(sums > 0, sums, 1.0), even)

    def places(self, totals: Float[np.ndarray, " pixel"]) -> Float[np.ndarray, " pixel"]:
        """Find the rows whose pulses are as many as those of pixels.

        Parameters
        ----------
        totals : pulses of each pixel

        Returns
        -------
        rows of the table, with fractions
        """
        logs = np.log(self.pulses.sum(axis=1))
        some = np.log(np.maximum(totals, np.finfo(float).tiny))
        return np.interp(-some, -logs, np.arange(len(logs), dtype=float))


def _pixels(images: Groups) -> Float[np.ndarray, "pixel group"]:
    """Images as rows of pixels."""
    moved = np.moveaxis(images, -3, -1)
    return np.ascontiguousarray(moved.reshape(-1, moved.shape[-1]), dtype=np.float64)


def _images(rows: Float[np.ndarray, "pixel channel"], shape: tuple[int, ...]) -> Counts:
    """Rows of pixels as images of the shape that they came from, with another number of channels."""
    frames, (height, width) = shape[:-3], shape[-2:]
    return np.moveaxis(rows.reshape(*frames, height, width, rows.shape[1]), -1, -3)
