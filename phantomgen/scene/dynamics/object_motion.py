"""Motion of an object that follows a signal: shift, rotation and scale around a pivot, a path, and a deformation."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

from phantomgen.geometry.rotation import rotation_matrix
from phantomgen.scene.dynamics.lattice import Lattice
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
    lattice : displacements where the signal is 1, which come before all other motion; None for an object that keeps its
        form
    """

    signal: str
    pivot: Triple
    shift: Triple = (0.0, 0.0, 0.0)
    rotation: Triple = (0.0, 0.0, 0.0)
    scale: Triple = (1.0, 1.0, 1.0)
    path: tuple[Triple, ...] = ()
    frame: Affine | None = None
    lattice: Lattice | None = None

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
        return replace(self, frame=whole)

    def points(self, points: Float[np.ndarray, "point 3"], value: float) -> Float[np.ndarray, "point 3"]:
        """Compute where points of the object at rest are.

        Parameters
        ----------
        points : (x, y, z) [mm]
        value : of the signal

        Returns
        -------
        points [mm]

        Raises
        ------
        InputError
            When the object shrinks to nothing.
        """
        if self.lattice is not None:
            frame = np.eye(4) if self.frame is None else self.frame
            local = _mapped(np.linalg.inv(frame), points)
            points = _mapped(frame, local + value * self.lattice.displacements(local))
        return _mapped(self.matrix(value), points)

    def check_folds(self, value: float) -> None:
        """Refuse a deformation that folds space.

        Parameters
        ----------
        value : of the signal

        Raises
        ------
        InputError
            When it does.
        """
        place = None if self.lattice is None else self.lattice.fold(value)
        if place is not None:
            x, y, z = place
            raise InputError(
                f"the deformation folds space at ({x:.3g}, {y:.3g}, {z:.3g}) mm where signal {self.signal!r} is "
                f"{value:.3g}: give smaller shifts, or points further apart"
            )


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


def bends(motions: Motions) -> bool:
    """Return whether a motion changes the form of an object.

    Parameters
    ----------
    motions : of the object and of its groups

    Returns
    -------
    True where one has a lattice
    """
    return any(motion.lattice is not None for motion in motions)


def moved_points(
    motions: Motions, values: Mapping[str, float], points: Float[np.ndarray, "point 3"]
) -> Float[np.ndarray, "point 3"]:
    """Compute where points of an object are.

    Parameters
    ----------
    motions : of the object and of its groups
    values : of the signals by name
    points : at rest (x, y, z) [mm]

    Returns
    -------
    points [mm]
    """
    for motion in motions:
        points = motion.points(points, values[motion.signal])
    return points


def _mapped(matrix: Affine, points: Float[np.ndarray, "point 3"]) -> Float[np.ndarray, "point 3"]:
    """Points under an affine map."""
    return points @ matrix[:3, :3].T + matrix[:3, 3]
