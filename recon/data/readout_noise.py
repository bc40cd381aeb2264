"""Noise that frames without beam have, as photons that nothing attenuates.

Its variance s is added to counts and to what is expected of them, so that counts have again a variance that is their
mean, and few of them are negative: shifted Poisson counts (Yavuz & Fessler 1998, Med. Image Anal. 2, 369).
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from spectra.transmission import Transmission


def with_floor(transmission: Transmission, variance: Float[np.ndarray, " channel"]) -> Transmission:
    """The same with a node in each channel that has such noise; its columns are 0."""
    noisy = np.flatnonzero(variance > 0)
    ends = transmission.starts[noisy + 1]
    return replace(
        transmission,
        columns=np.insert(transmission.columns, ends, 0.0, axis=1),
        weights=np.insert(transmission.weights, ends, variance[noisy]),
        starts=transmission.starts + np.append(0, np.cumsum(variance > 0)),
    )


def without_floor(transmission: Transmission) -> tuple[Transmission, Float[np.ndarray, " channel"]]:
    """The photons that are attenuated, and the variance of each channel that `with_floor` added."""
    moving = np.asarray(transmission.columns.any(axis=0))
    floor = _per_channel(np.where(moving, 0.0, transmission.weights), transmission)
    left = _per_channel(np.where(moving, 1.0, 0.0), transmission)
    bare = replace(
        transmission,
        columns=transmission.columns[:, moving],
        weights=transmission.weights[moving],
        starts=np.append(0, np.cumsum(left).astype(np.int64)),
    )
    return bare, floor


def _per_channel(values: Float[np.ndarray, " node"], transmission: Transmission) -> Float[np.ndarray, " channel"]:
    """Sums of values over the nodes of each channel, of which a blind one has none."""
    total = np.append(0.0, np.cumsum(values))
    return np.diff(total[transmission.starts])
