"""Capped cylinders, circular or elliptic, along any axis."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from phantomgen.ops.primitives import CYLINDER
from phantomgen.shapes.base import Shape, Triple, checked_lengths, checked_triple
from spectra.errors import InputError


@dataclass(frozen=True)
class Cylinder(Shape):
    """A cylinder with flat ends.

    Parameters
    ----------
    center : middle of the axis (x, y, z) [mm]
    radius : one radius, or the two of an elliptic cross-section, along x and y before turning [mm]
    length : distance between the two ends [mm]
    axis : direction of the axis, any length; z is turned into it the shortest way
    """

    center: Triple
    radius: float | tuple[float, float]
    length: float
    axis: Triple = (0.0, 0.0, 1.0)

    KIND: ClassVar[int] = CYLINDER

    def __post_init__(self) -> None:
        for name in ("center", "axis"):
            object.__setattr__(self, name, checked_triple("cylinder", name, getattr(self, name)))
        if np.shape(self.radius) not in ((), (2,)):
            raise InputError(f"cylinder radius must be one number or two, got {self.radius!r}")
        checked_lengths("cylinder", "radius", self.radii)
        checked_lengths("cylinder", "length", (self.length,))
        if not any(self.axis):
            raise InputError("cylinder axis must not be the zero vector")

    @property
    def radii(self) -> tuple[float, float]:
        """Both radii of the cross-section [mm]."""
        first, second = np.broadcast_to(np.asarray(self.radius, dtype=np.float64), 2)
        return float(first), float(second)

    @property
    def axes(self) -> Float[np.ndarray, "3 3"]:
        """Half axes as columns [mm]."""
        return _shortest_turn(np.asarray(self.axis)) * np.array([*self.radii, self.length / 2])


def _shortest_turn(axis: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "3 3"]:
    """Rotation that takes z into `axis` about their common normal; a half turn about x where axis is -z."""
    x, y, z = axis / np.linalg.norm(axis)
    if x * x + y * y == 0:
        return np.diag([1.0, z, z])
    # Rodrigues' formula with the turn's axis (-y, x, 0); 1 + z = (x^2 + y^2) / (1 - z) keeps its digits near -z.
    lift = (x * x + y * y) / (1 - z) if z < 0 else 1 + z
    return np.array([[1 - x * x / lift, -x * y / lift, x], [-x * y / lift, 1 - y * y / lift, y], [-x, -y, z]])
