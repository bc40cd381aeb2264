"""Readout noise, modelled as photons that nothing attenuates.

Its variance s is added to counts and to their expectation, so that the variance of counts equals their mean again, and
few of them are negative: shifted Poisson counts (Yavuz & Fessler 1998, Med. Image Anal. 2, 369).
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from spectra.transmission import Transmission


def with_floor(transmission: Transmission, variance: Float[np.ndarray, " channel"]) -> Transmission:
    """Add an energy node without attenuation to each channel that has readout noise.

    Parameters
    ----------
    transmission : spectral model of the photons
    variance : variance of frames without beam in each channel [counts^2]

    Returns
    -------
    spectral model of the shifted counts
    """
    noisy = np.flatnonzero(variance > 0)
    ends = transmission.starts[noisy + 1]
    return replace(
        transmission,
        columns=np.insert(transmission.columns, ends, 0.0, axis=1),
        weights=np.insert(transmission.weights, ends, variance[noisy]),
        starts=transmission.starts + np.append(0, np.cumsum(variance > 0)),
    )


def without_floor(transmission: Transmission) -> tuple[Transmission, Float[np.ndarray, " channel"]]:
    """Undo `with_floor`.

    Parameters
    ----------
    transmission : spectral model of shifted counts

    Returns
    -------
    spectral model of the photons; variance of each channel that `with_floor` added [counts^2]
    """
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
    """Sums of values over the nodes of each channel; a blind channel has no node."""
    total = np.append(0.0, np.cumsum(values))
    return np.diff(total[transmission.starts])
