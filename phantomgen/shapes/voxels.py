"""Boxes of voxels."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from phantomgen.ops.primitives import BOX
from phantomgen.ops.voxel_maps import VoxelMap
from phantomgen.shapes.base import Part, Shape, Term, local_map
from spectra.errors import InputError


@dataclass(frozen=True, eq=False)
class Voxels(Shape):
    """Voxel map in space; it has a material for each of its parts, and fills its box also where it is empty.

    Parameters
    ----------
    content : the map
    axes : half edges of the box along x, y and z of the map, as columns [mm]
    center : of the box (x, y, z) [mm]
    """

    content: VoxelMap
    axes: Float[np.ndarray, "3 3"]
    center: Float[np.ndarray, " 3"]

    def __post_init__(self) -> None:
        lengths = np.linalg.norm(self.axes, axis=0)
        skew = abs(self.axes.T @ self.axes / np.outer(lengths, lengths) - np.eye(3)).max()
        if not (np.isfinite(self.axes).all() and np.isfinite(self.center).all() and skew < 1e-4):
            raise InputError("axes of a voxel map must be finite and at right angles to each other")

    def __repr__(self) -> str:
        return f"Voxels({' x '.join(map(str, self.content.cells.shape))})"

    @property
    def terms(self) -> tuple[Term, ...]:
        """One term of one part."""
        return ((Part(BOX, local_map(self.axes, self.center), voxels=self.content),),)
