"""Subsets of the views that represent all of them, also where the tube voltage switches from view to view.

There, views lack channels. Views with the same channels are of one kind. A step that is a multiple of the period of the
kinds would select one kind only, and what the channels of the other kinds measure would seem to be unknown. So every
kind is sampled in the same way.
"""

import numpy as np
from jaxtyping import Float, Int


def kinds_of(exposure: Float[np.ndarray, "view channel"]) -> Int[np.ndarray, " view"]:
    """Number the kinds of views by the channels that they measured.

    Parameters
    ----------
    exposure : tube output of each view and channel, 0 where it was not measured

    Returns
    -------
    number of the kind of each view; 0 for all where no view lacks a channel
    """
    return np.unique(exposure > 0, axis=0, return_inverse=True)[1].reshape(-1)


def rounds_of(kinds: Int[np.ndarray, " view"]) -> int:
    """Count the sets of views that have one view of every kind, and so every channel.

    Parameters
    ----------
    kinds : kind of each view, see `kinds_of`

    Returns
    -------
    number of views over number of kinds, at least 1
    """
    return max(len(kinds) // len(_members(kinds)), 1)


def every(kinds: Int[np.ndarray, " view"], step: float) -> Int[np.ndarray, " few"]:
    """Take every `step`-th view of each kind, at least one of each, in order.

    Parameters
    ----------
    kinds : kind of each view, see `kinds_of`
    step : distance of two views of a kind; it need not be a whole number

    Returns
    -------
    indices of the views
    """
    members = _members(kinds)
    picked = []
    for place, views in enumerate(members):
        first = min(step * place / len(members), len(views) - 1)
        picked.append(views[np.arange(first, len(views), step).astype(int)])
    return np.sort(np.concatenate(picked))


def spread(kinds: Int[np.ndarray, " view"], count: int) -> Int[np.ndarray, " few"]:
    """Take about `count` views, evenly spread over those of each kind, at least one of each, in order.

    Parameters
    ----------
    kinds : kind of each view, see `kinds_of`
    count : number of views in all

    Returns
    -------
    indices of the views
    """
    picked = []
    for views in _members(kinds):
        share = max(round(min(count, len(kinds)) * len(views) / len(kinds)), 1)
        picked.append(views[np.linspace(0, len(views), share, endpoint=False).astype(int)])
    return np.sort(np.concatenate(picked))


def parts_of(kinds: Int[np.ndarray, " view"], count: int) -> list[Int[np.ndarray, " few"]]:
    """Divide all views into evenly spread parts, each with views of every kind where there are enough of them.

    Parameters
    ----------
    kinds : kind of each view, see `kinds_of`
    count : number of parts

    Returns
    -------
    indices of the views of each part
    """
    whole = [np.arange(first, len(kinds), count) for first in range(count)]
    members = _members(kinds)
    if all(len(np.unique(kinds[part])) == len(members) for part in whole):
        return whole
    part = np.empty(len(kinds), int)
    for place, views in enumerate(members):
        part[views] = (np.arange(len(views)) + place * count // len(members)) % count
    return [found for found in (np.flatnonzero(part == i) for i in range(count)) if len(found)]


def _members(kinds: Int[np.ndarray, " view"]) -> list[Int[np.ndarray, " few"]]:
    """Indices of the views of each kind."""
    return [np.flatnonzero(kinds == kind) for kind in np.unique(kinds)]
