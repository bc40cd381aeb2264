"""Modes of features by mean shift (Comaniciu & Meer 2002, doi:10.1109/34.1000236), as many as there are.

Each feature is measured in its noise, or in a small part of its range where the noise is less: then one bandwidth does
for all scenes. Modes come from at most 10000 samples on seeds that are binned; everything else is assigned to them.
So the time hardly grows with the model (`benchmarks/reconstruction/clustering.py`).
"""

import numpy as np
from jaxtyping import Float, Int
from threadpoolctl import threadpool_limits

from spectra.errors import InputError

BANDWIDTH = 3.0  # units of `unit_of`
FLOOR = 0.005  # least unit, of the range of a feature
SAMPLES = 10_000
RAREST = 0.001  # modes with a smaller part of the samples are left out
VALLEY = 0.5  # of the samples at a mode: one that has no valley before it is the tail of another
_TAIL = 0.005  # quantile where the range of a feature ends


def unit_of(
    samples: Float[np.ndarray, "sample feature"], noise: Float[np.ndarray, " feature"]
) -> Float[np.ndarray, " feature"]:
    """What each feature is measured in: its noise, but no less than a part of its range."""
    low, high = np.quantile(samples, [_TAIL, 1 - _TAIL], axis=0)
    return np.maximum(np.maximum(noise, FLOOR * (high - low)), 1e-6 * np.maximum(np.abs(high), 1e-6))


def find_modes(
    samples: Float[np.ndarray, "sample feature"],
    unit: Float[np.ndarray, " feature"],
    bandwidth: float = BANDWIDTH,
    seed: int = 0,
    most: int | None = SAMPLES,
) -> Float[np.ndarray, "mode feature"]:
    """Centres of the clusters, those with most samples first.

    Parameters
    ----------
    samples : features
    unit : what each is measured in
    bandwidth : radius of the flat kernel [units]
    seed : of the choice of samples
    most : samples to take; None for all

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
    with threadpool_limits(1):
        found = MeanShift(bandwidth=bandwidth, bin_seeding=True, min_bin_freq=max(int(rarest / 4), 1)).fit(chosen)
    sizes = np.bincount(found.labels_, minlength=len(found.cluster_centers_))
    kept = np.flatnonzero(sizes >= min(rarest, sizes.max()))
    return found.cluster_centers_[kept[np.argsort(-sizes[kept], kind="stable")]] * unit


def nearest_mode(
    samples: Float[np.ndarray, "sample feature"],
    modes: Float[np.ndarray, "mode feature"],
    unit: Float[np.ndarray, " feature"],
) -> Int[np.ndarray, " sample"]:
    """Index of the nearest mode of each sample."""
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
    """Whether no valley lies between a mode and a lower one, among the samples around the line from one to the other.

    Parameters
    ----------
    samples, mode, other : features [units of their noise]
    """
    length = float(np.linalg.norm(other - mode))
    way = (other - mode) / length
    along = (samples - mode) @ way
    aside = np.square(samples - mode).sum(axis=1) - np.square(along)
    steps = max(round(length), 2)
    counts = np.histogram(along[aside < 1] * (steps / length), np.arange(steps + 2) - 0.5)[0]
    return bool(counts[1:-1].min() >= VALLEY * counts[-1] > 0)
