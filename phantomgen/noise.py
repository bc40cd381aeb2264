"""Photon noise that depends on (seed, view, channel) and on nothing else.

Every image has its own Philox key (Salmon et al. 2011, doi:10.1145/2063384.2063405), so the counts are the same
whatever the number of threads, the order of views or the number of views asked for.
"""

from enum import IntEnum

import numpy as np
from jaxtyping import Float, Int32

from spectra.errors import InputError

LARGEST_MEAN = 2.0**31 - 2.0**20


class Stream(IntEnum):
    """What an image is; part of its key, so that projections and flats never share random numbers."""

    PROJECTION = 0
    FLAT = 1


def philox_key(seed: int, stream: Stream, frame: int, channel: int) -> int:
    """128-bit key: the seed above, then stream (8 bits), frame (32 bits) and channel (24 bits)."""
    if not 0 <= seed < 2**64:
        raise InputError(f"a seed must lie in 0 .. 2^64 - 1, got {seed}")
    return seed << 64 | int(stream) << 56 | frame << 24 | channel


def generator(seed: int, stream: Stream, frame: int, channel: int) -> np.random.RandomState:
    """Random numbers of one image; numpy freezes the stream of ``RandomState``, so files can be made again."""
    return np.random.RandomState(np.random.Philox(key=philox_key(seed, stream, frame, channel)))


def poisson_counts(
    mean: Float[np.ndarray, "row column"], seed: int, frame: int, channel: int, stream: Stream = Stream.PROJECTION
) -> Int32[np.ndarray, "row column"]:
    """One image of Poisson counts.

    Parameters
    ----------
    mean : expected counts, not negative
    seed, frame, channel, stream : the key

    Raises
    ------
    InputError
        When a mean is negative, not finite, or too large for 32-bit counts.
    """
    largest = mean.max(initial=0.0)
    if not (mean.min(initial=0.0) >= 0 and largest <= LARGEST_MEAN):
        raise InputError(f"expected counts must lie in 0 .. {LARGEST_MEAN:.0f}, got {mean.min():g} .. {largest:g}")
    return generator(seed, stream, frame, channel).poisson(mean).astype(np.int32)
