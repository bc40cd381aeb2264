"""Readings of the detector, frame by frame; only afterglow links them, and passes over them in order.

Frames are computed in parallel. Where there is afterglow, the signals of the views come together in order, and go on to
be read in parallel again. An interrupted scan goes on at any view: what is stored then is computed from the views
before, as their noise belongs to their keys.
"""

from collections.abc import Callable, Iterator
from typing import TypeVar

import numpy as np

from phantomgen.effects import Lag
from phantomgen.effects.random_streams import Stream
from phantomgen.simulation.forward_model.detector import Frame
from phantomgen.simulation.forward_model.frames import Views
from spectra.threads import run_parallel

T = TypeVar("T")
Signals = tuple[int, Frame, Frame]  # view, with noise, and without


def projections(
    views: Views, pack: Callable[[int, Frame, Frame], T], with_means: bool = False, first: int = 0
) -> Iterator[T]:
    """Return the results of `pack` for the readings of every view from `first` on, in order, computed in parallel.

    Parameters
    ----------
    views : of the scan
    pack : takes a view, the readings of all its channels, and those without noise, which are empty unless requested
    with_means : whether readings without noise are requested
    first : view to go on from

    Returns
    -------
    iterator over the results of `pack`
    """
    lag, count = views.scan.effects.lag, views.shape[0]

    def registered(view: int) -> Signals:
        expected = views.expected(view)
        means = views.registered(expected, view, noise=False) if with_means else []
        return view, views.registered(expected, view), means

    def read(signals: Signals) -> T:
        view, noisy, means = signals
        return pack(view, views.read(noisy, view), views.read(means, view, noise=False) if means else [])

    if lag is None:
        return run_parallel(lambda view: read(registered(view)), range(first, count))
    starts = {int(part[0]) for part in views.scan.splits.values() if len(part)}
    begin = lag.first_needed(first, starts)
    late = _with_lag(lag, run_parallel(registered, range(begin, count)), starts)
    return run_parallel(read, (signals for signals in late if signals[0] >= first))


def flat(views: Views, frame: int) -> Frame:
    """Compute the readings of one flat.

    Parameters
    ----------
    views : frames of the scan
    frame : number of the flat

    Returns
    -------
    readings of each channel
    """
    return views.read(views.registered(views.expected(frame, Stream.FLAT), frame, Stream.FLAT), frame, Stream.FLAT)


def dark(views: Views, frame: int) -> Frame:
    """Compute the readings of one frame without beam.

    Parameters
    ----------
    views : frames of the scan
    frame : number of the frame

    Returns
    -------
    readings of each channel
    """
    panel = views.scan.geometry.panel
    nothing = np.zeros((len(views.scan.detector), panel.rows, panel.columns))
    return views.read(list(nothing), frame, Stream.DARK)


def _with_lag(lag: Lag, frames: Iterator[Signals], starts: set[int]) -> Iterator[Signals]:
    """Signals with the afterglow of those before them."""
    stored = None
    for view, noisy, means in frames:
        both = np.stack([*noisy, *means])
        measured, stored = lag.read(both, lag.empty(both.shape) if stored is None or view in starts else stored)
        yield view, list(measured[: len(noisy)]), list(measured[len(noisy) :])
