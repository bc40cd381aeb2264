"""Some of the views, such that they stand for all of them, also where tube voltages are switched from view to view.

Views that lack channels are of several kinds. A step that is a multiple of their period would meet one kind only, and
what no channel of that kind measures would seem to be unknown. So every kind is taken from in the same way.
"""

import numpy as np
from jaxtyping import Float, Int


def kinds_of(exposure: Float[np.ndarray, "view channel"]) -> Int[np.ndarray, " view"]:
    """Which views were taken with the same channels: a number per kind, 0 for all where no view lacks a channel."""
    return np.unique(exposure > 0, axis=0, return_inverse=True)[1].reshape(-1)


def rounds_of(kinds: Int[np.ndarray, " view"]) -> int:
    """Views over kinds, at least 1: that many sets of views have every kind, and so every channel."""
    return max(len(kinds) // len(_members(kinds)), 1)


def every(kinds: Int[np.ndarray, " view"], step: float) -> Int[np.ndarray, " few"]:
    """One view of so many of each kind, at least one of each, in order.

    Parameters
    ----------
    kinds : of all views, see `kinds_of`
    step : views between two of them; it need not be a whole number
    """
    members = _members(kinds)
    picked = []
    for place, views in enumerate(members):
        first = min(step * place / len(members), len(views) - 1)
        picked.append(views[np.arange(first, len(views), step).astype(int)])
    return np.sort(np.concatenate(picked))


def spread(kinds: Int[np.ndarray, " view"], count: int) -> Int[np.ndarray, " few"]:
    """About `count` views, evenly spread over those of each kind, at least one of each, in order."""
    picked = []
    for views in _members(kinds):
        share = max(round(min(count, len(kinds)) * len(views) / len(kinds)), 1)
        picked.append(views[np.linspace(0, len(views), share, endpoint=False).astype(int)])
    return np.sort(np.concatenate(picked))


def parts_of(kinds: Int[np.ndarray, " view"], count: int) -> list[Int[np.ndarray, " few"]]:
    """All views in so many evenly spread parts, each with views of every kind where there are enough of them."""
    whole = [np.arange(first, len(kinds), count) for first in range(count)]
    members = _members(kinds)
    if all(len(np.unique(kinds[part])) == len(members) for part in whole):
        return whole
    part = np.empty(len(kinds), int)
    for place, views in enumerate(members):
        part[views] = (np.arange(len(views)) + place * count // len(members)) % count
    return [found for found in (np.flatnonzero(part == i) for i in range(count)) if len(found)]


def _members(kinds: Int[np.ndarray, " view"]) -> list[Int[np.ndarray, " few"]]:
    """Views of each kind."""
    return [np.flatnonzero(kinds == kind) for kind in np.unique(kinds)]
