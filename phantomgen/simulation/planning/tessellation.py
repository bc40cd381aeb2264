"""How fine the triangles must be that stand for smooth surfaces: sweeps, and surfaces of CAD files."""

import numpy as np

from phantomgen.scene.scan import Scan
from phantomgen.simulation.forward_model.discretization import Settings
from phantomgen.simulation.planning.plan import Choice, Trial
from phantomgen.simulation.planning.sample_windows import exposed, windows_of, worst_difference
from spectra.transmission import Transmission

# Triangles of smooth surfaces so many times finer than usual, from cheap to fine.
LADDER = (1, 2, 4, 8)
# The reference has so many times more corners around and along.
_FINER = 4
# Seed of the sample, apart from that of the noise, so that plans do not depend on it.
_SEED = 7


def choose_tessellation(scan: Scan, transmission: Transmission, share: float) -> tuple[Scan, Choice]:
    """Find the coarsest triangles whose worst error of log counts stays within `share`, or the finest ones.

    Parameters
    ----------
    scan : with `file`, so that its surfaces can be made finer
    transmission : path lengths to counts
    share : of the tolerance

    Returns
    -------
    the scan with these triangles, and the choice
    """
    trials: list[Trial] = []
    for fineness in LADDER:
        candidate = scan.tessellated(fineness)
        error = _difference(candidate, scan.tessellated(_FINER * fineness), transmission)
        trials.append(Trial(f"triangles {fineness} times finer than usual", error, float(fineness**2)))
        if error <= share:
            break
    return candidate, Choice("tessellation", trials[-1].setting, trials[-1].error, share, tuple(trials))


def _difference(coarse: Scan, fine: Scan, transmission: Transmission) -> float:
    """Worst difference of log counts in some windows."""
    windows = windows_of(fine, transmission, np.random.default_rng(_SEED))
    found = [[exposed(scan, transmission, window, Settings()).counts for window in windows] for scan in (coarse, fine)]
    return worst_difference(*found)
