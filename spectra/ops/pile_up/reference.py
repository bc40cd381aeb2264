"""Counts of pulses that pile up as the formulas read: the truth in tests, never used in production."""

import numpy as np
from jaxtyping import Float

from spectra.ops.pile_up import Lattice


def recorded_counts(
    events: Float[np.ndarray, " group"], load: float, paralyzable: bool, lattice: Lattice
) -> Float[np.ndarray, " channel"]:
    """Compute the mean recorded counts of one pixel, as a sum over the number of pulses in a dead time.

    Parameters
    ----------
    events : mean pulses of each group of heights
    load : all of them per dead time
    paralyzable : kind of the counter
    lattice : of the groups

    Returns
    -------
    counts of each channel
    """
    total = events.sum()
    pulse = np.zeros(lattice.whole[-1] + 1)  # distribution of one height, up to the last threshold
    for first, parts, mean in zip(lattice.first, lattice.parts, events[:-1], strict=True):
        for point, part in enumerate(parts):
            if part > 0:
                pulse[first + point] += part * mean / total
    chance, heights = np.exp(-load), [np.eye(1, len(pulse))[0]]
    while len(heights) < len(pulse) + 2:  # no pulse has the height 0
        heights.append(np.convolve(heights[-1], pulse)[: len(pulse)])
    above = []
    for k, (whole, part) in enumerate(zip(lattice.whole, lattice.part, strict=True)):
        one = events[: lattice.below[k]].sum() / total
        below = [1.0, one, *(h[:whole].sum() + part * h[whole] for h in heights[2:])]  # sums of 0, 1, 2, ... pulses
        weights = chance * np.cumprod([1.0, *(load / n for n in range(1, len(below)))])
        piled, with_one = (float(np.dot(weights[: len(b)], b)) for b in (below, below[1:]))
        above.append(total * (piled - with_one) if paralyzable else total / (1 + load) * (1 - with_one))
    return -np.diff(np.append(above, 0.0))
