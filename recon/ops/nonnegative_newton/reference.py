"""Nearest non-negative point by trying every set of coefficients that may be 0, in float64."""

from itertools import product

import numpy as np
from jaxtyping import Float


def nonnegative_newton_step(
    start: Float[np.ndarray, " basis"],
    inverse: Float[np.ndarray, "basis basis"],
    cotangent: Float[np.ndarray, " basis"],
) -> Float[np.ndarray, " basis"]:
    """Minimise ``cotangent x + (x - start) inverse^-1 (x - start) / 2`` over x >= 0, for one voxel.

    Parameters
    ----------
    start : start of the step
    inverse : inverse of the voxel's block
    cotangent : gradient at the start

    Returns
    -------
    x
    """
    metric = np.linalg.inv(inverse)
    wanted = start - inverse @ cotangent
    best, least = np.zeros_like(wanted), np.inf
    for free in product([False, True], repeat=len(wanted)):
        f, x = np.array(free), np.zeros_like(wanted)
        if f.any():
            x[f] = np.linalg.solve(metric[np.ix_(f, f)], (metric @ wanted)[f])
        cost = (x - wanted) @ metric @ (x - wanted)
        if (x >= 0).all() and cost < least:
            best, least = x, cost
    return best
