"""Motion of an object that follows a signal: shift, rotation and scale around a pivot, and a path."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

from phantomgen.geometry.rotation import rotation_matrix
from spectra.errors import InputError

Triple = tuple[float, float, float]
Affine = Float[np.ndarray, "4 4"]
# Least scale that an object may shrink to.
_LEAST_SCALE = 0.01


@dataclass(frozen=True, eq=False)
class ObjectMotion:
    """Motion of one object, or of a group as a whole.

    Parameters
    ----------
    signal : name of the signal that it follows
    pivot : point that stays where it is but for shift and path [mm]
    shift : where the signal is 1 [mm]
    rotation : where the signal is 1, about the fixed x, then y, then z axis [rad]
    scale : along x, y and z, where the signal is 1
    path : further shifts at equal steps of the signal from 0 to 1 [mm], (point, 3), joined by a cubic spline
    frame : matrix from the frame that all of these are given in to the world
    """

    signal: str
    pivot: Triple
    shift: Triple = (0.0, 0.0, 0.0)
    rotation: Triple = (0.0, 0.0, 0.0)
    scale: Triple = (1.0, 1.0, 1.0)
    path: tuple[Triple, ...] = ()
    frame: Affine | None = None

    def matrix(self, value: float) -> Affine:
        """Compute where the points of the object at rest are.

        Parameters
        ----------
        value : of the signal

        Returns
        -------
        affine map of points [mm]

        Raises
        ------
        InputError
            When the object shrinks to nothing.
        """
        scale = 1 + value * (np.array(self.scale) - 1)
        if scale.min() < _LEAST_SCALE:
            raise InputError(
                f"motion scales to {scale.min():.3g} of the size where signal {self.signal!r} is {value:.3g}: an "
                f"object keeps at least {_LEAST_SCALE:g} of it"
            )
        a, b, c = (value * np.array(self.rotation)).tolist()
        linear = rotation_matrix((a, b, c)) * scale
        pivot, moved = np.array(self.pivot), np.eye(4)
        moved[:3, :3] = linear
        moved[:3, 3] = pivot - linear @ pivot + value * np.array(self.shift) + self._along_path(value)
        return moved if self.frame is None else self.frame @ moved @ np.linalg.inv(self.frame)

    def _along_path(self, value: float) -> Float[np.ndarray, " 3"]:
        """Shift along the path; beyond its ends, that of the ends [mm]."""
        if not self.path:
            return np.zeros(3)
        return CubicSpline(np.linspace(0, 1, len(self.path)), np.array(self.path))(min(max(value, 0.0), 1.0))

    def within(self, frame: Affine) -> "ObjectMotion":
        """Return the motion of an object that is placed.

        Parameters
        ----------
        frame : map from the frame of the motion to where the object is placed

        Returns
        -------
        the motion there
        """
        whole = frame if self.frame is None else frame @ self.frame
        return ObjectMotion(self.signal, self.pivot, self.shift, self.rotation, self.scale, self.path, whole)


Motions = tuple[ObjectMotion, ...]
"""Motions of an object: its own, then those of the groups that it belongs to, from the inside outwards."""


def total_motion(motions: Motions, values: Mapping[str, float]) -> Affine:
    """Compute where the points of an object are.

    Parameters
    ----------
    motions : of the object and of its groups
    values : of the signals by name

    Returns
    -------
    affine map of points of the object at rest [mm]
    """
    total = np.eye(4)
    for motion in motions:
        total = motion.matrix(values[motion.signal]) @ total
    return total
