"""Spheres and ellipsoids."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from phantomgen.geometry.rotation import rotation_matrix
from phantomgen.ops.primitives import BALL
from phantomgen.shapes.base import Primitive, Triple, checked_lengths, checked_triple


@dataclass(frozen=True)
class Sphere(Primitive):
    """Ball.

    Parameters
    ----------
    center : (x, y, z) [mm]
    radius : [mm]
    """

    center: Triple
    radius: float

    KIND: ClassVar[int] = BALL

    def __post_init__(self) -> None:
        object.__setattr__(self, "center", checked_triple("sphere", "center", self.center))
        checked_lengths("sphere", "radius", (self.radius,))

    @property
    def axes(self) -> Float[np.ndarray, "3 3"]:
        """Half axes as columns [mm]."""
        return self.radius * np.eye(3)


@dataclass(frozen=True)
class Ellipsoid(Primitive):
    """Ellipsoid.

    Parameters
    ----------
    center : (x, y, z) [mm]
    radii : half axes along x, y and z before turning [mm]
    rotation : angles about the fixed x, then y, then z axis [rad]
    """

    center: Triple
    radii: Triple
    rotation: Triple = (0.0, 0.0, 0.0)

    KIND: ClassVar[int] = BALL

    def __post_init__(self) -> None:
        for name in ("center", "radii", "rotation"):
            object.__setattr__(self, name, checked_triple("ellipsoid", name, getattr(self, name)))
        checked_lengths("ellipsoid", "radii", self.radii)

    @property
    def axes(self) -> Float[np.ndarray, "3 3"]:
        """Half axes as columns [mm]."""
        return rotation_matrix(self.rotation) * np.asarray(self.radii)
