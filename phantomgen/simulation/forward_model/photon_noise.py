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


def coincident_counts(
    mean: Float[np.ndarray, "channel row column"],
    shares: Float[np.ndarray, "step channel channel channel"],
    sensor_pixels: tuple[float, float],
    seed: int,
    frame: int,
    stream: Stream = Stream.PROJECTION,
) -> list[Int32[np.ndarray, "row column"]]:
    """Draw one frame whose photons may count in two neighbouring pixels of the sensor.

    Parameters
    ----------
    mean : expected counts of each channel
    shares : see `spectra.detector.coincidences.CoincidenceShares`
    sensor_pixels : pixels of the sensor in one of the panel, from row to row and from column to column
    seed, frame, stream : the key

    Returns
    -------
    counts of each channel, (row, column)

    Notes
    -----
    Photons that count twice are Poisson numbers, which are added to both pixels; what is missing of the expected counts
    is drawn for each pixel alone. Of two pixels that expect different numbers of such photons, the smaller one is
    taken. So all means are the expected ones, and the covariance is exact where neighbours expect the same.
    """
    _check_mean(mean)
    channels, random = len(mean), generator(seed, stream, frame, len(mean))
    twice, single = np.zeros(mean.shape, np.int64), mean.copy()
    for step, factor in _steps_of_panel(*sensor_pixels).items():
        if not factor.any():
            continue
        for a, b in np.ndindex(channels, channels):
            expected = np.tensordot(factor @ shares[:, a, b], mean, axes=1)
            here, there = _neighbours(mean.shape[1:], *step)
            both = np.minimum(expected[here], expected[there])
            drawn = random.poisson(both)
            for channel, place in ((a, here), (b, there)):
                single[channel][place] -= both
                twice[channel][place] += drawn
    return [
        (twice[c] + generator(seed, stream, frame, c).poisson(np.maximum(single[c], 0.0))).astype(np.int32)
        for c in range(channels)
    ]


def _steps_of_panel(down: float, right: float) -> dict[tuple[int, int], Float[np.ndarray, " step"]]:
    """Pixels of the panel that neighbours on the sensor lie in, and how many of them, along an edge and a corner.

    Two neighbours lie in one pixel of the panel, or in two: of the pairs across n pixels of the sensor 1 / n is cut.
    """
    cut, whole = np.array([1 / down, 1 / right]), np.array([1 - 1 / down, 1 - 1 / right])
    return {
        (0, 0): np.array([whole.sum(), 2 * whole.prod()]),
        (0, 1): np.array([cut[1], 2 * whole[0] * cut[1]]),
        (1, 0): np.array([cut[0], 2 * whole[1] * cut[0]]),
        (1, 1): np.array([0.0, cut.prod()]),
        (1, -1): np.array([0.0, cut.prod()]),
    }


def _neighbours(shape: tuple[int, ...], down: int, right: int) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Pixels that have a neighbour so far down and right, and these neighbours."""
    rows, columns = shape
    return (
        (slice(0, rows - down), slice(max(-right, 0), columns - max(right, 0))),
        (slice(down, rows), slice(max(right, 0), columns + min(right, 0))),
    )


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
    parts: Float[np.ndarray, "channel row column"],
    total: Float[np.ndarray, "row column"],
    dead_time: DeadTime,
    seed: int,
    frame: int,
    stream: Stream = Stream.PROJECTION,
) -> list[Int32[np.ndarray, "row column"]]:
    """Draw one frame of a detector with dead time, channel by channel.

    Parameters
    ----------
    parts : expected counts of each channel, in proportion
    total : expected events of all channels, recorded or not
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
    _check_mean(parts)
    random = generator(seed, stream, frame, len(parts))
    left = _sub_poisson(total * dead_time.live(total), dead_time.fano(total), random)
    rest, images = parts.sum(axis=0), []
    for channel, mean in enumerate(parts):
        share = np.divide(mean, rest, out=np.ones_like(mean), where=rest > 0)
        taken = generator(seed, stream, frame, channel).binomial(left, np.clip(share, 0.0, 1.0))
        images.append(taken.astype(np.int32))
        left, rest = left - taken, rest - mean
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
