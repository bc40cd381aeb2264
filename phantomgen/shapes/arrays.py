"""An ordered list of shapes with their materials, as the arrays that operators work on."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int64

from phantomgen.shapes.base import Shape
from spectra.errors import InputError


@dataclass(frozen=True, eq=False)
class ShapeArrays:
    """Shapes in order of priority: a later one owns the space that it shares with an earlier one.

    Parameters
    ----------
    kinds : primitive of each shape, a code of `phantomgen.ops.primitives`
    locals_ : map from world [mm] to local coordinates of each shape
    materials : index of each shape's material
    """

    kinds: Int64[np.ndarray, " shape"]
    locals_: Float[np.ndarray, "shape 3 4"]
    materials: Int64[np.ndarray, " shape"]

    @classmethod
    def of(cls, objects: Iterable[tuple[Shape, int]]) -> "ShapeArrays":
        """Arrays of (shape, material index) pairs, lowest priority first."""
        pairs = list(objects)
        if any(index < 0 for _, index in pairs):
            raise InputError(f"material indices must not be negative, got {[index for _, index in pairs]}")
        return cls(
            kinds=np.array([shape.KIND for shape, _ in pairs], dtype=np.int64),
            locals_=np.array([shape.local for shape, _ in pairs], dtype=np.float64).reshape(-1, 3, 4),
            materials=np.array([index for _, index in pairs], dtype=np.int64),
        )

    def __len__(self) -> int:
        return len(self.kinds)
