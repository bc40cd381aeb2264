"""Noise of photons: counts, summed energies, counts lost to dead time."""

import numpy as np
from jaxtyping import Float, Float32, Int, Int32

from phantomgen.effects.random_streams import Stream, generator
from spectra.detector.dead_time import DeadTime
from spectra.errors import InputError

# Largest expected counts: a Poisson number, 20 standard deviations above, still fits 32 bits.
LARGEST_MEAN = 2.0**31 - 2.0**20
# Variances closer to the mean than this part of it are those of Poisson counts.
_POISSON_LIKE = 1e-6


def poisson_counts(
    mean: Float[np.ndarray, "row column"], seed: int, frame: int, channel: int, stream: Stream = Stream.PROJECTION
) -> Int32[np.ndarray, "row column"]:
    """Draw one image of Poisson counts.

    Parameters
    ----------
    mean : expected counts, not negative
    seed, frame, channel, stream : the key

    Returns
    -------
    counts, (row, column)

    Raises
    ------
    InputError
        When a mean is negative, not finite, or too large for 32-bit counts.
    """
    _check_mean(mean)
    return generator(seed, stream, frame, channel).poisson(mean).astype(np.int32)


def compound_signal(
    mean: Float[np.ndarray, "group row column"],
    quanta: Float[np.ndarray, " group"],
    seed: int,
    frame: int,
    channel: int,
    stream: Stream = Stream.PROJECTION,
) -> Float32[np.ndarray, "row column"]:
    """Draw one image of an energy-integrating detector: Poisson numbers of photons times the signal of one photon.

    Parameters
    ----------
    mean : expected signal that photons of each group of energies make
    quanta : signal of one photon of each group
    seed, frame, channel, stream : the key

    Returns
    -------
    signal, (row, column)
    """
    photons = mean / quanta[:, None, None]
    _check_mean(photons)
    random = generator(seed, stream, frame, channel)
    signal = np.zeros(mean.shape[1:])
    for group, quantum in zip(photons, quanta, strict=True):
        signal += quantum * random.poisson(group)
    return signal.astype(np.float32)


def dead_time_counts(
    events: Float[np.ndarray, "channel row column"],
    dead_time: DeadTime,
    seed: int,
    frame: int,
    stream: Stream = Stream.PROJECTION,
) -> list[Int32[np.ndarray, "row column"]]:
    """Draw one frame of a detector with dead time, channel by channel.

    Parameters
    ----------
    events : expected events of each channel, recorded or not
    dead_time : of the pixels
    seed, frame, stream : the key

    Returns
    -------
    counts of each channel, (row, column)

    Notes
    -----
    All recorded counts of a pixel are one binomial number, whose mean and variance are those of the counter; it is then
    split between channels, as every recorded count has a channel of its own. Without dead time both steps together are
    independent Poisson counts.
    """
    _check_mean(events)
    total = events.sum(axis=0)
    random = generator(seed, stream, frame, len(events))
    left = _sub_poisson(total * dead_time.live(total), dead_time.fano(total), random)
    images = []
    for channel, mean in enumerate(events):
        share = np.divide(mean, total, out=np.ones_like(mean), where=total > 0)
        taken = generator(seed, stream, frame, channel).binomial(left, np.clip(share, 0.0, 1.0))
        images.append(taken.astype(np.int32))
        left, total = left - taken, total - mean
    return images


def _sub_poisson(
    mean: Float[np.ndarray, "row column"], fano: Float[np.ndarray, "row column"], random: np.random.RandomState
) -> Int[np.ndarray, "row column"]:
    """Counts whose variance is `fano` times their mean, at most 1: binomial, or Poisson where that is the same."""
    chance = 1 - fano
    poisson = random.poisson(mean)
    some = chance > _POISSON_LIKE
    trials = np.divide(mean, chance, out=np.zeros_like(mean), where=some)
    whole = np.floor(trials + random.random_sample(mean.shape)).astype(np.int64)
    return np.where(some, random.binomial(whole, np.where(some, chance, 0.0)), poisson)


def _check_mean(mean: Float[np.ndarray, "..."]) -> None:
    """Refuse means that are negative, not finite, or too large for 32-bit counts."""
    largest = mean.max(initial=0.0)
    if not (mean.min(initial=0.0) >= 0 and largest <= LARGEST_MEAN):
        raise InputError(f"expected counts must lie in 0 .. {LARGEST_MEAN:.0f}, got {mean.min():g} .. {largest:g}")
