"""What all shapes share: each is a unit primitive under an affine map.

A shape says how its local axes lie in space, ``x_world = center + axes @ x_local``, where the columns of `axes` are its
half axes in mm. Points, volumes, chords and silhouettes all follow from that map and the primitive.
"""

from abc import ABC, abstractmethod
from math import cos, pi, prod, sin
from typing import ClassVar

import numpy as np
from jaxtyping import Bool, Float

from phantomgen.ops.primitives import BALL, BOX, CYLINDER
from spectra.errors import InputError

Triple = tuple[float, float, float]

_UNIT_VOLUME = {BALL: 4 / 3 * pi, CYLINDER: 2 * pi, BOX: 8.0}


class Shape(ABC):
    """A convex region; subclasses are frozen dataclasses with a `center` (x, y, z) [mm]."""

    KIND: ClassVar[int]
    center: Triple

    @property
    @abstractmethod
    def axes(self) -> Float[np.ndarray, "3 3"]:
        """Half axes as columns [mm], orthogonal to each other."""

    @property
    def local(self) -> Float[np.ndarray, "3 4"]:
        """Map from world [mm] to local coordinates, ``x_local = local[:, :3] @ x + local[:, 3]``."""
        axes = self.axes
        inverse = (axes / (axes**2).sum(axis=0)).T
        return np.column_stack([inverse, -inverse @ np.asarray(self.center, dtype=np.float64)])

    @property
    def volume(self) -> float:
        """Volume [mm^3]."""
        return _UNIT_VOLUME[self.KIND] * float(np.prod(np.linalg.norm(self.axes, axis=0)))

    @property
    def bounds(self) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, " 3"]]:
        """Lowest and highest corner of the tight axis-aligned box around the shape [mm]."""
        axes, center = self.axes, np.asarray(self.center, dtype=np.float64)
        reach = {
            BALL: np.linalg.norm(axes, axis=1),
            CYLINDER: np.linalg.norm(axes[:, :2], axis=1) + np.abs(axes[:, 2]),
            BOX: np.abs(axes).sum(axis=1),
        }[self.KIND]
        return center - reach, center + reach

    def contains(self, points: Float[np.ndarray, "point 3"]) -> Bool[np.ndarray, " point"]:
        """Which points (x, y, z) [mm] lie inside; flat faces are half open."""
        local = self.local
        x, y, z = local[:, :3] @ np.asarray(points, dtype=np.float64).T + local[:, 3:]
        if self.KIND == BALL:
            return x**2 + y**2 + z**2 < 1
        within = (z >= -1) & (z < 1)
        if self.KIND == CYLINDER:
            return within & (x**2 + y**2 < 1)
        return within & (x >= -1) & (x < 1) & (y >= -1) & (y < 1)


def rotation_matrix(angles: Triple) -> Float[np.ndarray, "3 3"]:
    """Rotation about the fixed x axis, then y, then z, by `angles` [rad]."""
    (cx, cy, cz), (sx, sy, sz) = map(cos, angles), map(sin, angles)
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


def checked_triple(shape: str, name: str, value: object) -> Triple:
    """`value` as three finite floats, or a sentence that names the shape and its parameter."""
    array = np.asarray(value, dtype=np.float64)
    if array.shape != (3,) or not np.isfinite(array).all():
        raise InputError(f"{shape} {name} must be three finite numbers, got {value!r}")
    return (float(array[0]), float(array[1]), float(array[2]))


def checked_lengths(shape: str, name: str, values: tuple[float, ...]) -> None:
    """Refuse lengths that are not positive, finite, and within 1e-9 .. 1e9 mm, where the local map stays exact."""
    if not all(1e-9 <= value <= 1e9 for value in values) or prod(values) == 0:
        shown = values[0] if len(set(values)) == 1 else values
        raise InputError(f"{shape} {name} must be positive and finite [mm], got {shown!r}")
