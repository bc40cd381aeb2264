"""Capped cylinders, circular or elliptic, along any axis, solid or hollow, with flat or round ends."""

from dataclasses import dataclass
from math import pi
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from phantomgen.ops.primitives import CYLINDER
from phantomgen.shapes.ball import Sphere
from phantomgen.shapes.base import (
    Primitive,
    Shape,
    Term,
    Triple,
    checked_axis,
    checked_lengths,
    checked_triple,
    shortest_turn,
)
from spectra.errors import InputError


@dataclass(frozen=True)
class Cylinder(Primitive):
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
        object.__setattr__(self, "center", checked_triple("cylinder", "center", self.center))
        object.__setattr__(self, "axis", checked_axis("cylinder", "axis", self.axis))
        if np.shape(self.radius) not in ((), (2,)):
            raise InputError(f"cylinder radius must be one number or two, got {self.radius!r}")
        checked_lengths("cylinder", "radius", self.radii)
        checked_lengths("cylinder", "length", (self.length,))

    @property
    def radii(self) -> tuple[float, float]:
        """Both radii of the cross-section [mm]."""
        first, second = np.broadcast_to(np.asarray(self.radius, dtype=np.float64), 2)
        return float(first), float(second)

    @property
    def axes(self) -> Float[np.ndarray, "3 3"]:
        """Half axes as columns [mm]."""
        return shortest_turn(self.axis) * np.array([*self.radii, self.length / 2])


@dataclass(frozen=True)
class Tube(Shape):
    """A circular cylinder with a coaxial bore.

    Parameters
    ----------
    center : middle of the axis (x, y, z) [mm]
    radius, inner_radius : of the outer and of the inner wall [mm]
    length : distance between the two ends [mm]
    axis : direction of the axis, any length
    """

    center: Triple
    radius: float
    inner_radius: float
    length: float
    axis: Triple = (0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        object.__setattr__(self, "center", checked_triple("tube", "center", self.center))
        object.__setattr__(self, "axis", checked_axis("tube", "axis", self.axis))
        checked_lengths("tube", "radius", (self.radius,))
        checked_lengths("tube", "inner_radius", (self.inner_radius,))
        checked_lengths("tube", "length", (self.length,))
        if self.inner_radius >= self.radius:
            raise InputError(f"tube inner_radius {self.inner_radius:g} must be smaller than its radius {self.radius:g}")

    @property
    def terms(self) -> tuple[Term, ...]:
        """The outer cylinder without the inner one."""
        wall, bore = (
            Cylinder(self.center, radius, self.length, self.axis).terms[0][0]
            for radius in (self.radius, self.inner_radius)
        )
        return ((wall, bore.opposite),)

    @property
    def volume(self) -> float:
        """Volume [mm^3]."""
        return pi * (self.radius - self.inner_radius) * (self.radius + self.inner_radius) * self.length


@dataclass(frozen=True)
class Capsule(Shape):
    """A circular cylinder with half balls on its ends.

    Parameters
    ----------
    center : middle of the axis (x, y, z) [mm]
    radius : of the cylinder and of its ends [mm]
    length : of the straight part [mm]
    axis : direction of the axis, any length
    """

    center: Triple
    radius: float
    length: float
    axis: Triple = (0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        object.__setattr__(self, "center", checked_triple("capsule", "center", self.center))
        object.__setattr__(self, "axis", checked_axis("capsule", "axis", self.axis))
        checked_lengths("capsule", "radius", (self.radius,))
        checked_lengths("capsule", "length", (self.length,))

    @property
    def terms(self) -> tuple[Term, ...]:
        """The cylinder and two balls."""
        middle = Cylinder(self.center, self.radius, self.length, self.axis)
        ends = [np.asarray(self.center) + side * middle.axes[:, 2] for side in (-1, 1)]
        balls = [Sphere((float(x), float(y), float(z)), self.radius) for x, y, z in ends]
        return tuple(term for shape in (middle, *balls) for term in shape.terms)

    @property
    def volume(self) -> float:
        """Volume [mm^3]."""
        return pi * self.radius**2 * (self.length + 4 / 3 * self.radius)
