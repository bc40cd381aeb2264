"""Cones, whole or cut off, along any axis."""

from dataclasses import dataclass
from math import pi

import numpy as np

from phantomgen.ops.primitives import CONE
from phantomgen.shapes.base import (
    Part,
    Shape,
    Term,
    Triple,
    checked_axis,
    checked_lengths,
    checked_triple,
    local_map,
    shortest_turn,
)
from phantomgen.shapes.cylinder import Cylinder
from spectra.errors import InputError


@dataclass(frozen=True)
class Cone(Shape):
    """A circular cone, or a frustum where neither radius is 0.

    Parameters
    ----------
    center : middle of the axis (x, y, z) [mm]
    radii : at the beginning and at the end of the axis [mm]; one of them may be 0
    length : distance between the two ends [mm]
    axis : direction of the axis, any length
    """

    center: Triple
    radii: tuple[float, float]
    length: float
    axis: Triple = (0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        object.__setattr__(self, "center", checked_triple("cone", "center", self.center))
        object.__setattr__(self, "axis", checked_axis("cone", "axis", self.axis))
        if np.shape(self.radii) != (2,):
            raise InputError(f"cone radii must be two numbers, got {self.radii!r}")
        object.__setattr__(self, "radii", (float(self.radii[0]), float(self.radii[1])))
        checked_lengths("cone", "radii", (max(self.radii),))
        checked_lengths("cone", "length", (self.length,))
        if min(self.radii) < 0:
            raise InputError(f"cone radii must not be negative, got {self.radii!r}")
        if abs(self.radii[0] - self.radii[1]) < 1e-6 * max(self.radii):
            raise InputError(f"cone radii must differ, got {self.radii!r}: take a cylinder")

    @property
    def terms(self) -> tuple[Term, ...]:
        """A cone from its tip to the wide end, without a cylinder around the tip that reaches to the narrow end."""
        narrow, wide = sorted(self.radii)
        turn = shortest_turn(self.axis)
        along = turn[:, 2] * (1.0 if self.radii[1] > self.radii[0] else -1.0)  # from the narrow end to the wide one
        height = self.length * wide / (wide - narrow)
        tip = np.asarray(self.center) + along * (self.length / 2 - height)
        axes = np.column_stack([turn[:, 0] * wide, turn[:, 1] * wide, along * height])
        cone = Part(CONE, local_map(axes, tip))
        if narrow == 0:
            return ((cone,),)
        missing = height - self.length
        x, y, z = tip + along * missing / 2
        # Its rim is the rim of the frustum: silhouettes know it.
        cut = Cylinder((float(x), float(y), float(z)), narrow, missing, (along[0], along[1], along[2]))
        return ((cone, cut.terms[0][0].opposite),)

    @property
    def volume(self) -> float:
        """Volume [mm^3]."""
        first, last = self.radii
        return pi / 3 * self.length * (first * first + first * last + last * last)
