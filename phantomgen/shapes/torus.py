"""Rings."""

from dataclasses import dataclass
from math import pi

import numpy as np

from phantomgen.ops.primitives import TORUS
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
from spectra.errors import InputError


@dataclass(frozen=True)
class Torus(Shape):
    """Ring with a circular cross-section.

    Parameters
    ----------
    center : (x, y, z) [mm]
    radius : from the centre to the middle of the tube [mm]
    tube : radius of the tube [mm], smaller than `radius`
    axis : normal of the ring's plane, any length
    """

    center: Triple
    radius: float
    tube: float
    axis: Triple = (0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        object.__setattr__(self, "center", checked_triple("torus", "center", self.center))
        object.__setattr__(self, "axis", checked_axis("torus", "axis", self.axis))
        checked_lengths("torus", "radius", (self.radius,))
        checked_lengths("torus", "tube", (self.tube,))
        if self.tube >= self.radius:
            raise InputError(f"torus tube {self.tube:g} must be smaller than its radius {self.radius:g}")

    @property
    def terms(self) -> tuple[Term, ...]:
        """One term of one part, scaled to an outer radius of 1."""
        outer = self.radius + self.tube
        local = local_map(shortest_turn(self.axis) * outer, np.asarray(self.center))
        return ((Part(TORUS, local, tube=self.tube / outer),),)

    @property
    def volume(self) -> float:
        """Volume [mm^3] (Pappus)."""
        return 2 * pi**2 * self.radius * self.tube**2
