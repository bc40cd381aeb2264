"""Which views are left: training views by arc and number; test views stay, so that results can be compared."""

import numpy as np
from jaxtyping import Float, Int64, Integer

from spectra.errors import InputError

Splits = dict[str, Int64[np.ndarray, " _view"]]
# Rounding of angles in files [degree].
_ROUNDING = 1e-6


def within_arc(
    views: Integer[np.ndarray, " view"], angles: Float[np.ndarray, " all"], arc: tuple[float, float], helical: bool
) -> Integer[np.ndarray, " left"]:
    """Return the views whose angle lies in an arc.

    Parameters
    ----------
    views : indices of the views, the first of which has angle 0 of the arc
    angles : rotation angle of every view of the scan [rad]
    arc : first angle, which belongs to the arc, and last angle, which does not [degree]
    helical : count turns, in place of taking all angles modulo 360 degrees

    Returns
    -------
    indices of the views, in the same order

    Raises
    ------
    InputError
        When views have no angles, or none lies in the arc.
    """
    chosen = np.rad2deg(angles[views])
    if not np.isfinite(chosen).all():
        raise InputError(
            "an arc needs views with rotation angles, and this scan has free poses: choose views by number"
        )
    along = chosen - chosen[0]
    if len(along) > 1 and _nearest(along[1]) < 0:
        along = -along
    if not helical:
        along = (along + _ROUNDING) % 360 - _ROUNDING
    inside = (along >= arc[0] - _ROUNDING) & (along < arc[1] - _ROUNDING)
    if not inside.any():
        raise InputError(
            f"the arc {arc[0]:g}:{arc[1]:g} holds no training view: they lie from 0 to {along.max():g} degrees, "
            "counted from the first"
        )
    return views[inside]


def evenly_spread(views: Integer[np.ndarray, " view"], count: int) -> Integer[np.ndarray, " left"]:
    """Return some of the views, evenly spread.

    Parameters
    ----------
    views : indices of the views
    count : how many

    Returns
    -------
    indices

    Raises
    ------
    InputError
        When there are not so many.
    """
    if count > len(views):
        raise InputError(f"there are {len(views)} training views to choose from: {count} cannot be used")
    return views[np.arange(count) * len(views) // count]


def renumbered(splits: Splits, train: Integer[np.ndarray, " left"]) -> tuple[Integer[np.ndarray, " kept"], Splits]:
    """Replace the training views, keep all other splits, and number the views that are left anew.

    Parameters
    ----------
    splits : indices of the views of each split
    train : the training views that are left

    Returns
    -------
    indices of the views that are left, ascending, and the splits in terms of their places
    """
    new = {**splits, "train": train}
    kept = np.unique(np.concatenate(list(new.values())).astype(np.int64))
    return kept, {name: np.searchsorted(kept, views) for name, views in new.items()}


def _nearest(angle: float) -> float:
    """Angle modulo 360, in -180 .. 180 [degree]."""
    return (angle + 180) % 360 - 180
