"""Modes of features by mean shift; their number follows from the samples.

Each feature is divided by its noise, or by a small part of its range where the noise is less, so that one bandwidth is
right for all scenes. Modes are found from at most 10 000 samples, with seeds on a grid of bins; all other samples are
assigned to the nearest mode. The time therefore hardly depends on the size of the model
(`benchmarks/reconstruction/clustering.py`).

References
----------
Comaniciu, Meer 2002, Mean shift: a robust approach toward feature space analysis, doi:10.1109/34.1000236.
"""

from warnings import catch_warnings, filterwarnings

import numpy as np
from jaxtyping import Float, Int
from threadpoolctl import threadpool_limits

from spectra.errors import InputError

BANDWIDTH = 3.0  # units of `unit_of`; radius of the flat kernel; our choice
FLOOR = 0.005  # part of the range of a feature; least unit; our choice
SAMPLES = 10_000  # samples; largest number in a mean shift; agreement in benchmarks/reconstruction/clustering.py
RAREST = 0.001  # part of the samples; modes with fewer are left out; our choice
VALLEY = 0.5  # part of the samples at a mode; with more between it and another it is the tail of the other; our choice
_TAIL = 0.005  # quantile at which the range of a feature begins and ends; our choice


def unit_of(
    samples: Float[np.ndarray, "sample feature"], noise: Float[np.ndarray, " feature"]
) -> Float[np.ndarray, " feature"]:
    """Compute the unit of each feature: its noise, but not less than a part of its range.

    Parameters
    ----------
    samples : features
    noise : standard deviation of the noise of each feature

    Returns
    -------
    unit of each feature
    """
    low, high = np.quantile(samples, [_TAIL, 1 - _TAIL], axis=0)
    return np.maximum(np.maximum(noise, FLOOR * (high - low)), 1e-6 * np.maximum(np.abs(high), 1e-6))


def find_modes(
    samples: Float[np.ndarray, "sample feature"],
    unit: Float[np.ndarray, " feature"],
    bandwidth: float = BANDWIDTH,
    seed: int = 0,
    most: int | None = SAMPLES,
) -> Float[np.ndarray, "mode feature"]:
    """Find the centres of the clusters by mean shift.

    Parameters
    ----------
    samples : features
    unit : unit of each feature
    bandwidth : radius of the flat kernel [units]
    seed : seed of the choice of samples
    most : largest number of samples; None for all

    Returns
    -------
    modes, those with most samples first; modes of less than `RAREST` of the samples are left out

    Raises
    ------
    InputError
        When there are no samples.
    """
    from sklearn.cluster import MeanShift  # noqa: PLC0415 - a second

    if not len(samples):
        raise InputError("there is nothing to cluster: no place of the volume is denser than air")
    chosen = np.asarray(samples, dtype=np.float64) / unit
    if most is not None and len(chosen) > most:
        chosen = chosen[np.random.default_rng(seed).choice(len(chosen), most, replace=False)]
    rarest = max(RAREST * len(chosen), 1)
    with threadpool_limits(1), catch_warnings():
        filterwarnings("ignore", "Binning data failed")  # each sample is in a bin of its own, and begins a mode
        found = MeanShift(bandwidth=bandwidth, bin_seeding=True, min_bin_freq=max(int(rarest / 4), 1)).fit(chosen)
    sizes = np.bincount(found.labels_, minlength=len(found.cluster_centers_))
    kept = np.flatnonzero(sizes >= min(rarest, sizes.max()))
    return found.cluster_centers_[kept[np.argsort(-sizes[kept], kind="stable")]] * unit


def nearest_mode(
    samples: Float[np.ndarray, "sample feature"],
    modes: Float[np.ndarray, "mode feature"],
    unit: Float[np.ndarray, " feature"],
) -> Int[np.ndarray, " sample"]:
    """Find the nearest mode of each sample.

    Parameters
    ----------
    samples : features
    modes : features of the modes
    unit : unit of each feature

    Returns
    -------
    indices of the modes
    """
    nearest = np.zeros(len(samples), np.intp)
    least = np.full(len(samples), np.inf)
    for index, mode in enumerate(modes):
        distance = np.square((samples - mode) / unit).sum(axis=1)
        closer = distance < least
        nearest[closer], least[closer] = index, distance[closer]
    return nearest


def is_tail(
    samples: Float[np.ndarray, "sample feature"],
    mode: Float[np.ndarray, " feature"],
    other: Float[np.ndarray, " feature"],
) -> bool:
    """Report whether there is no valley of density between a mode and a lower one.

    Parameters
    ----------
    samples : features in units of their noise
    mode, other : features of the two modes, in the same units; `other` is the lower one

    Returns
    -------
    True when the samples around the line between the modes show no valley
    """
    length = float(np.linalg.norm(other - mode))
    way = (other - mode) / length
    along = (samples - mode) @ way
    aside = np.square(samples - mode).sum(axis=1) - np.square(along)
    steps = max(round(length), 2)
    counts = np.histogram(along[aside < 1] * (steps / length), np.arange(steps + 2) - 0.5)[0]
    return bool(counts[1:-1].min() >= VALLEY * counts[-1] > 0)
