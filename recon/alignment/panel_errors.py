"""Errors of the panel's pose that an alignment estimates: a shift along its columns, and a turn in its plane.

A shift along the rows is left out. On a circular orbit a shift of the object along the axis explains nearly all of it:
what is left is less than voxels err at the ends of the object (`docs/explanation/alignment.md`).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from phantomgen.geometry.panel_changes import moved_panel
from phantomgen.geometry.poses import Geometry
from spectra.errors import InputError


@dataclass(frozen=True)
class PanelError:
    """One number of the panel's pose.

    Parameters
    ----------
    name : as users type it
    unit : of the number
    about : what it is, for tables
    largest : standard uncertainty above which a correction is not applied, in `unit`; chosen by hand
    """

    name: str
    unit: str
    about: str
    largest: float


# In the order of the vectors of numbers below.
ERRORS = (
    PanelError("columns", "pixel", "shift along the columns", 0.5),
    PanelError("tilt", "degree", "turn in the panel's plane", 0.5),
)
COLUMNS, TILT = range(2)  # places in ERRORS
NAMES = tuple(error.name for error in ERRORS)
Change = Float[np.ndarray, " error"]


def changed(geometry: Geometry, change: Change) -> Geometry:
    """Move and turn the panel of every view.

    Parameters
    ----------
    geometry : poses
    change : columns [pixel], turn from columns towards rows about the panel's centre [degree]

    Returns
    -------
    moved poses
    """
    columns, tilt = (float(number) for number in change)
    return moved_panel(geometry, columns, tilt)


def steps_of(geometry: Geometry, factor: int) -> Change:
    """Choose steps for central differences: a quarter of a block of pixels, for a turn at the edge of the panel.

    Parameters
    ----------
    geometry : poses of the whole panel
    factor : pixels along each side of a block

    Returns
    -------
    step of each number
    """
    pixels = 0.25 * factor
    half = max(geometry.panel.columns, geometry.panel.rows) / 2
    return np.array([pixels, np.rad2deg(pixels / half)])


def checked_names(names: tuple[str, ...]) -> tuple[int, ...]:
    """Return the places of errors in `ERRORS`.

    Parameters
    ----------
    names : what is to be estimated

    Returns
    -------
    places, ascending

    Raises
    ------
    InputError
        When there is no such error, or none is named.
    """
    for name in names:
        if name not in NAMES:
            raise InputError(f"an alignment estimates {', '.join(NAMES)}, got {name!r}")
    if not names:
        raise InputError(f"name something to estimate: {', '.join(NAMES)}")
    return tuple(sorted({NAMES.index(name) for name in names}))
