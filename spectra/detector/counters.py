"""Counts above each threshold, as counters have them, and counts between thresholds, as energy bins have them.

A pulse adds one to every counter whose threshold it exceeds. The counts between neighbouring thresholds are therefore
differences of counters; within a pixel these are independent Poisson numbers, which the counters are not.
"""

import numpy as np
from jaxtyping import Num, Shaped


def above_thresholds(between: Num[np.ndarray, "channel ..."]) -> Num[np.ndarray, "channel ..."]:
    """Sum the counts of each channel and of all channels above it.

    Parameters
    ----------
    between : counts between thresholds, or anything that adds up as they do, channels in ascending order of energy

    Returns
    -------
    counts above the threshold of each channel, of the same type
    """
    return np.cumsum(between[::-1], axis=0, dtype=between.dtype)[::-1]


def between_thresholds(above: Num[np.ndarray, "channel ..."]) -> Num[np.ndarray, "channel ..."]:
    """Subtract from the counts of each channel those of the next, the inverse of `above_thresholds`.

    Parameters
    ----------
    above : counts above the threshold of each channel, channels in ascending order of energy

    Returns
    -------
    counts between thresholds, of a signed type
    """
    between = above.astype(np.int64) if above.dtype.kind == "u" else above.copy()
    between[:-1] -= above[1:]
    return between


def either_neighbour(mask: Shaped[np.ndarray, "channel ..."]) -> Shaped[np.ndarray, "channel ..."]:
    """Mark the channels between thresholds that lack one of their two counters.

    Parameters
    ----------
    mask : whether the counter of each channel is not used

    Returns
    -------
    whether the difference to the next counter is not known
    """
    both = mask.copy()
    both[:-1] |= mask[1:]
    return both
