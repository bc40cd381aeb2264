"""Counts of pulses that pile up: from mean pulses of each height to mean counts between thresholds, and back.

While pulses overlap, their heights add: two photons below a threshold count as one above it.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int64

from spectra.ops.pile_up import cpu
from spectra.threads import run_parallel

__all__ = ["Lattice", "Load", "Shapes", "event_counts", "recorded_counts"]

# Pixels per piece of work of a thread; changes time, not results.
_PIXELS_PER_PIECE = 4096

PerPixel = Float[np.ndarray, " pixel"]
Pulses = Float[np.ndarray, "pixel group"]
Counts = Float[np.ndarray, "pixel channel"]


class Lattice(NamedTuple):
    """Groups of pulse heights on a lattice that ends at the last threshold.

    Parameters
    ----------
    first : lattice point at which each group begins, but for the last group, which lies above the last threshold
    parts : of the group at that point and those after it; heights are even within a group
    below : groups below each threshold
    whole, part : points that lie below each threshold, whole ones and the part of the next
    """

    first: Int64[np.ndarray, " group"]
    parts: Float[np.ndarray, "group point"]
    below: Int64[np.ndarray, " channel"]
    whole: Int64[np.ndarray, " channel"]
    part: Float[np.ndarray, " channel"]

    @classmethod
    def of(cls, edges: Float[np.ndarray, " edge"], thresholds: Sequence[float], step: float) -> "Lattice":
        """Create the lattice.

        Parameters
        ----------
        edges : of the groups, ascending, thresholds among them; the first is the lowest threshold [keV]
        thresholds : ascending [keV]
        step : of the lattice [keV], smaller than the lowest threshold

        Returns
        -------
        the lattice
        """
        low, high = (np.asarray(side) / step for side in (edges[:-2], edges[1:-1]))
        first = np.floor(low + 0.5).astype(np.int64)
        points = first[:, None] + np.arange(int(np.ceil((high - low).max(initial=0.0))) + 2)
        overlap = np.minimum(points + 0.5, high[:, None]) - np.maximum(points - 0.5, low[:, None])
        ends = np.asarray(thresholds) / step + 0.5
        whole = np.floor(ends).astype(np.int64)
        # Points at and above the last threshold are not wanted; a group may reach half a step beyond it.
        size = whole[-1] + 1
        parts = np.where(points < size, np.maximum(overlap, 0.0), 0.0) / (high - low)[:, None]
        below = np.searchsorted(edges, thresholds).astype(np.int64)
        return cls(first, parts, below, whole, ends - whole)


class Load(NamedTuple):
    """How busy pixels are.

    Parameters
    ----------
    loads : pulses per dead time
    idle : exp(-loads), the part of the time in which no pulse is there
    paralyzable : whether each rise of the signal through a threshold counts; else a pixel is busy for a dead time after
        a count, whose height is the sum of all pulses in it
    """

    loads: PerPixel
    idle: PerPixel
    paralyzable: bool

    @classmethod
    def of(cls, loads: PerPixel, paralyzable: bool) -> "Load":
        """Create it from the loads.

        Parameters
        ----------
        loads, paralyzable : see the class

        Returns
        -------
        how busy pixels are
        """
        return cls(loads, np.exp(-loads), paralyzable)

    def part(self, pixels: slice) -> tuple[PerPixel, PerPixel, bool]:
        """Take some pixels.

        Parameters
        ----------
        pixels : which

        Returns
        -------
        the same of these
        """
        return self.loads[pixels], self.idle[pixels], self.paralyzable


class Shapes(NamedTuple):
    """How the events of a channel are distributed over its groups of heights.

    Parameters
    ----------
    parts : of the channel's events in each group, for at least two spectra
    places : of each pixel between the rows of `parts`
    starts : first group of each channel, and the number of groups
    """

    parts: Float[np.ndarray, "spectrum group"]
    places: PerPixel
    starts: Int64[np.ndarray, " channel_plus_1"]


def recorded_counts(events: Pulses, load: Load, lattice: Lattice) -> Counts:
    """Compute the mean recorded counts between thresholds.

    Parameters
    ----------
    events : mean pulses of each group of heights, (pixel, group)
    load : of all pulses of each pixel
    lattice : of the groups

    Returns
    -------
    counts, (pixel, channel)
    """
    out = np.empty((len(events), len(lattice.below)))
    _over_pixels(lambda rows: cpu.counts(events[rows], load.part(rows), tuple(lattice), out[rows]), len(out))
    return out


def event_counts(recorded: Counts, totals: PerPixel, load: Load, lattice: Lattice, shapes: Shapes) -> Counts:
    """Compute the mean events between thresholds that give recorded counts, the inverse of `recorded_counts`.

    Parameters
    ----------
    recorded : counts, (pixel, channel); negative ones, which readout noise makes, count as none
    totals : events of all channels, which follow from all recorded counts
    load : of these events
    lattice : of the groups
    shapes : of the events within channels

    Returns
    -------
    events, (pixel, channel)
    """
    out = np.empty_like(recorded)

    def piece(rows: slice) -> None:
        own = (shapes.parts, shapes.places[rows], shapes.starts)
        cpu.events(recorded[rows], totals[rows], load.part(rows), tuple(lattice), own, out[rows])

    _over_pixels(piece, len(out))
    return out


def _over_pixels(task: Callable[[slice], None], count: int) -> None:
    """Run `task` on pieces of the pixels; each piece writes its own rows, so threads do not change the result."""
    firsts = range(0, count, _PIXELS_PER_PIECE)
    for _ in run_parallel(task, (slice(first, first + _PIXELS_PER_PIECE) for first in firsts)):
        pass
