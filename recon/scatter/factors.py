"""Factors of scatter that explain the counts of a scan best: one, or one per channel.

Slopes are derivatives of the log likelihood (`recon.scatter.voxel_fit.VoxelFit.slopes`), and the factors are where they
are zero. Large voxels find one factor within a tenth, in little time; their misfit at edges looks like scatter. From
there, voxels of the size of the grid find it, or one factor per channel, by Newton's method with differences, and then
by Broyden's updates (Broyden 1965, doi:10.1090/S0025-5718-1965-0198670-6).
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float
from scipy.optimize import root_scalar

LARGEST = 16.0  # largest factor that is searched for; chosen by hand, not measured
SEARCHES = 8  # steps of a search between two factors at most; chosen by hand, not measured
ENOUGH = 0.02  # change of a factor at which a search ends; below its error, see docs/howto/scatter.md
DIFFERENCE = 0.2  # change of a factor for a difference of slopes; chosen by hand, not measured
UPDATES = 4  # steps of Newton's method at most; chosen by hand, not measured

Factors = Float[np.ndarray, " factor"]


def factor_between(slope: Callable[[float], float]) -> float:
    """Find the zero of a slope that falls with the factor.

    Parameters
    ----------
    slope : derivative of the log likelihood in one factor

    Returns
    -------
    the factor, from 0 to `LARGEST`
    """
    known: dict[float, float] = {}

    def kept(factor: float) -> float:
        if factor not in known:
            known[factor] = slope(factor)
        return known[factor]

    if kept(0.0) <= 0:
        return 0.0
    high = 1.0
    while kept(high) > 0 and high < LARGEST:
        high *= 2
    if kept(high) > 0:
        return high
    low = max(factor for factor, value in known.items() if value > 0)
    found = root_scalar(kept, method="brentq", bracket=(low, high), xtol=ENOUGH, maxiter=SEARCHES)
    return float(found.root)


def factors_near(slopes: Callable[[Factors], Factors], start: Factors) -> Factors:
    """Find the zeros of slopes near some factors.

    Parameters
    ----------
    slopes : derivatives of the log likelihood in all factors
    start : factors to begin with

    Returns
    -------
    the factors, from 0 to `LARGEST`
    """
    factors, found = start, slopes(start)
    steps = DIFFERENCE * np.eye(len(start))
    changes = np.stack([(slopes(start + step) - found) / DIFFERENCE for step in steps], axis=1)
    for left in reversed(range(UPDATES)):
        ahead = np.clip(factors - np.linalg.lstsq(changes, found, rcond=None)[0], 0.0, LARGEST)
        step, factors = ahead - factors, ahead
        if np.abs(step).max() < ENOUGH or not left:
            break
        there = slopes(factors)
        changes += np.outer(there - found - changes @ step, step) / (step @ step)
        found = there
    return factors
