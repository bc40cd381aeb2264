"""How many points a focal spot of finite size needs."""

from dataclasses import replace

import numpy as np

from phantomgen.effects.focal_spot import LATTICES, FocalSpot
from phantomgen.scene.scan import Scan
from phantomgen.simulation.forward_model.discretization import Settings
from phantomgen.simulation.planning.plan import Choice, Trial
from phantomgen.simulation.planning.sample_windows import Image, Window, exposed, windows_of, worst_difference
from spectra.threads import run_parallel
from spectra.transmission import Transmission

# Lattices that are tried, and the reference.
_LADDER, _FINEST = tuple(LATTICES)[1:-1], max(LATTICES)
# Windows that numbers of source points are tried on, and the seed that these are drawn by.
_WINDOWS, _SEED = 3, 8


def choose_spot(
    scan: Scan, spot: FocalSpot, transmission: Transmission, settings: Settings, share: float
) -> tuple[Settings, Choice]:
    """Find the fewest source points whose worst error of log counts stays within `share`, against far more points.

    Parameters
    ----------
    scan, spot : what is simulated, and the focal spot of its source
    transmission : path lengths to counts
    settings : to be completed
    share : of the tolerance

    Returns
    -------
    settings with the number of points, and the choice
    """
    windows = windows_of(scan, transmission, np.random.default_rng(_SEED))
    windows = windows[:: max(1, len(windows) // _WINDOWS)]

    def averages(points: int) -> list[Image]:
        return [_average(scan, transmission, window, spot, points) for window in windows]

    finest, trials = averages(_FINEST), []
    for points in _LADDER:
        error = worst_difference(averages(points), finest)
        trials.append(Trial(f"{points} points of the spot", error, float(points)))
        if error <= share:
            break
    chosen = trials[-1] if trials[-1].error <= share else min(trials, key=lambda trial: trial.error)
    choice = Choice("focal spot", chosen.setting, chosen.error, share, tuple(trials))
    return replace(settings, spot=int(chosen.cost)), choice


def _average(scan: Scan, transmission: Transmission, window: Window, spot: FocalSpot, points: int) -> Image:
    """Counts of a window, averaged over points of the source."""

    def one(frame: np.ndarray) -> Image:
        return exposed(scan, transmission, replace(window, frame=frame), Settings()).counts

    frames = list(spot.frames(window.frame, points))
    return sum(run_parallel(one, frames)) / len(frames)  # type: ignore[return-value]
