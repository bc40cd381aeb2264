"""Subsets of the views that represent all of them, also where the tube voltage switches from view to view.

There, views lack channels. Views with the same channels form a group. A step that is a multiple of the period of the
groups would select one group only, and the channels of the other groups would be missing. So all groups are sampled in
the same way.
"""

import numpy as np
from jaxtyping import Float, Int

STRIDE = 0.38  # of all subsets; from one step to the next, near the golden section, so that views are far apart


def view_groups(exposure: Float[np.ndarray, "view channel"]) -> Int[np.ndarray, " view"]:
    """Number the groups of views by the channels that they measured.

    Parameters
    ----------
    exposure : tube output of each view and channel, 0 where it was not measured

    Returns
    -------
    number of the group of each view; 0 for all where no view lacks a channel
    """
    return np.unique(exposure > 0, axis=0, return_inverse=True)[1].reshape(-1)


def count_complete_sets(groups: Int[np.ndarray, " view"]) -> int:
    """Count the sets of views that have one view of every group, and so every channel.

    Parameters
    ----------
    groups : group of each view, see `view_groups`

    Returns
    -------
    number of views over number of groups, at least 1
    """
    return max(len(groups) // len(_members(groups)), 1)


def every_nth_view(groups: Int[np.ndarray, " view"], step: float) -> Int[np.ndarray, " few"]:
    """Take every `step`-th view of each group, at least one of each, in order.

    Parameters
    ----------
    groups : group of each view, see `view_groups`
    step : distance of two views of a group; it need not be a whole number

    Returns
    -------
    indices of the views
    """
    members = _members(groups)
    picked = []
    for place, views in enumerate(members):
        first = min(step * place / len(members), len(views) - 1)
        picked.append(views[np.arange(first, len(views), step).astype(int)])
    return np.sort(np.concatenate(picked))


def evenly_spread_views(groups: Int[np.ndarray, " view"], count: int) -> Int[np.ndarray, " few"]:
    """Take about `count` views, evenly spread over those of each group, at least one of each, in order.

    Parameters
    ----------
    groups : group of each view, see `view_groups`
    count : number of views in all

    Returns
    -------
    indices of the views
    """
    picked = []
    for views in _members(groups):
        share = max(round(min(count, len(groups)) * len(views) / len(groups)), 1)
        picked.append(views[np.linspace(0, len(views), share, endpoint=False).astype(int)])
    return np.sort(np.concatenate(picked))


def interleaved_subsets(groups: Int[np.ndarray, " view"], count: int) -> list[Int[np.ndarray, " few"]]:
    """Divide all views into evenly spread parts, each with views of every group where there are enough of them.

    Parameters
    ----------
    groups : group of each view, see `view_groups`
    count : number of parts

    Returns
    -------
    indices of the views of each part
    """
    whole = [np.arange(first, len(groups), count) for first in range(count)]
    members = _members(groups)
    if all(len(np.unique(groups[part])) == len(members) for part in whole):
        return whole
    part = np.empty(len(groups), int)
    for place, views in enumerate(members):
        part[views] = (np.arange(len(views)) + place * count // len(members)) % count
    return [found for found in (np.flatnonzero(part == i) for i in range(count)) if len(found)]


def golden_section_order(count: int) -> list[int]:
    """Order subsets of the views such that subsequent ones are far apart on the orbit.

    Each is about 0.38 of the orbit after the one before it, near the golden section.

    Parameters
    ----------
    count : number of subsets

    Returns
    -------
    every number from 0 to `count` - 1 once
    """
    stride = next(s for s in range(max(int(STRIDE * count), 1), count + 1) if np.gcd(s, count) == 1)
    return [i * stride % count for i in range(count)]


def _members(groups: Int[np.ndarray, " view"]) -> list[Int[np.ndarray, " few"]]:
    """Indices of the views of each group."""
    return [np.flatnonzero(groups == group) for group in np.unique(groups)]
