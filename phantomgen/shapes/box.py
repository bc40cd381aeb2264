"""Boxes."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from phantomgen.geometry.rotation import rotation_matrix
from phantomgen.ops.primitives import BOX
from phantomgen.shapes.base import Primitive, Triple, checked_lengths, checked_triple


@dataclass(frozen=True)
class Box(Primitive):
    """A rectangular box.

    Parameters
    ----------
    center : (x, y, z) [mm]
    size : full edge lengths along x, y and z before turning [mm]
    rotation : angles about the fixed x, then y, then z axis [rad]
    """

    center: Triple
    size: Triple
    rotation: Triple = (0.0, 0.0, 0.0)

    KIND: ClassVar[int] = BOX

    def __post_init__(self) -> None:
        for name in ("center", "size", "rotation"):
            object.__setattr__(self, name, checked_triple("box", name, getattr(self, name)))
        checked_lengths("box", "size", self.size)

    @property
    def axes(self) -> Float[np.ndarray, "3 3"]:
        """Half axes as columns [mm]."""
        return rotation_matrix(self.rotation) * (np.asarray(self.size) / 2)
