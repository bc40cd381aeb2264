"""Photon noise that depends on (seed, view, channel) and on nothing else.

Every image has its own Philox key (Salmon et al. 2011, doi:10.1145/2063384.2063405), so the counts are the same
whatever the number of threads, the order of views or the number of views.
"""

from enum import IntEnum

import numpy as np

from spectra.errors import InputError


class Stream(IntEnum):
    """Kind of random numbers; a part of their key, so that projections and flats have different ones."""

    PROJECTION = 0
    FLAT = 1
    TUBE = 2
    JITTER = 3
    MOTION = 4
    SCATTER = 6
    GAIN = 10
    DEFECTS = 11
    PROJECTION_READING = 12
    FLAT_READING = 13
    DARK = 14
    DOSE = 15
    FLAT_DOSE = 16
    SIGNAL = 17


def philox_key(seed: int, stream: Stream, frame: int, channel: int) -> int:
    """Compute the 128-bit key: the seed above, then stream (8 bits), frame (32 bits) and channel (24 bits).

    Parameters
    ----------
    seed : of the scan
    stream : kind of random numbers
    frame, channel : indices of the image

    Returns
    -------
    the key

    Raises
    ------
    InputError
        When the seed is not within 0 .. 2^64 - 1.
    """
    if not 0 <= seed < 2**64:
        raise InputError(f"a seed must lie in 0 .. 2^64 - 1, got {seed}")
    return seed << 64 | int(stream) << 56 | frame << 24 | channel


def generator(seed: int, stream: Stream, frame: int, channel: int) -> np.random.RandomState:
    """Create the random numbers of one image.

    numpy freezes the stream of ``RandomState``, so files can be reproduced.

    Parameters
    ----------
    seed, stream, frame, channel : see `philox_key`

    Returns
    -------
    random numbers
    """
    return np.random.RandomState(np.random.Philox(key=philox_key(seed, stream, frame, channel)))
