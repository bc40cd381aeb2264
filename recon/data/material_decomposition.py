"""Decomposition of counts into line integrals of the bases, for whole scans."""

import numpy as np
from jaxtyping import Float

from recon.data.array_store import IN_MEMORY, ArrayStore, read_part, release
from recon.data.measurements import Measurements
from recon.ops.decompose import decompose


def decompose_views(
    measurements: Measurements, dispersion: float = 0.0, store: ArrayStore = IN_MEMORY
) -> tuple[Float[np.ndarray, "view basis row column"], Float[np.ndarray, "basis basis"]]:
    """Find the maximum-likelihood line integrals of every view, and their mean Fisher matrix.

    Parameters
    ----------
    measurements : views to decompose, at any binning
    dispersion : relative model error added to the Poisson variance [no unit]
    store : storage of the line integrals

    Returns
    -------
    one image per view and basis [no unit]; Fisher matrix of a ray, mean over all rays
    """
    views, channels, rows, columns = measurements.counts.shape
    bases = len(measurements.basis_names)
    images = store.empty("line_integrals", (views, bases, rows, columns))
    fisher = np.zeros((bases, bases))
    profile = measurements.profile
    known = None if profile is None else np.ascontiguousarray(profile.reshape(len(profile), -1).T)
    for view in range(views):
        counts = read_part(measurements.counts, view).reshape(channels, -1).T
        gains = (measurements.exposure[view, :, None, None] * measurements.gains).reshape(channels, -1).T
        lengths, information = decompose(counts, gains, measurements.transmission, dispersion, known=known)
        images[view] = lengths.T.reshape(bases, rows, columns)
        release(images)
        fisher += information.mean(axis=0) / views
    return images, fisher
