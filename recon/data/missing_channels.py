"""Counts of channels that some views lack, interpolated between the views before and after."""

import numpy as np
from jaxtyping import Float, Int

from recon.data.array_store import read_part
from recon.data.partial_volume import LEAST_COUNTS


def interpolate_missing(
    counts: Float[np.ndarray, "view channel row column"],
    exposure: Float[np.ndarray, "view channel"],
    views: Int[np.ndarray, " few"],
) -> tuple[Float[np.ndarray, "few channel row column"], Float[np.ndarray, "few channel"]]:
    """Interpolate missing channels of some views, linearly in the logarithm of counts.

    Parameters
    ----------
    counts : counts of all views
    exposure : tube output of each view and channel, 0 where it was not measured
    views : indices of the views to complete

    Returns
    -------
    counts of these views, and their exposure with 1 for what was interpolated; a channel that no view has stays missing
    """
    completed, known = np.asarray(read_part(counts, views)), exposure[views]
    for c in np.flatnonzero((exposure > 0).any(axis=0)):
        measuring = np.flatnonzero(exposure[:, c] > 0)
        for place in np.flatnonzero(known[:, c] == 0):
            view = views[place]
            after = np.searchsorted(measuring, view)
            a, b = measuring[max(after - 1, 0)], measuring[min(after, len(measuring) - 1)]
            part = (view - a) / (b - a) if b > a else 0.0
            logs = [np.log(np.maximum(counts[v, c], LEAST_COUNTS) / exposure[v, c]) for v in (a, b)]
            completed[place, c] = np.exp((1 - part) * logs[0] + part * logs[1])
            known[place, c] = 1.0
    return completed, known
