"""Objects and materials of a scan, at rest or at one instant."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Float32

from phantomgen.geometry.voxel_grid import Grid
from phantomgen.ops.solids import Solids
from phantomgen.ops.trace import trace
from phantomgen.ops.voxelize_shapes import fractions
from phantomgen.shapes import Shape, solids_of
from spectra.materials.material import Material


@dataclass(frozen=True)
class SceneObjects:
    """Objects of a scan; later ones override earlier ones where they overlap.

    Parameters
    ----------
    objects : shapes with the index of their material; voxel maps with those of their parts
    materials : those that an object or the background consists of, in the order of the file, then those known by name
    background : index of the material around the objects, -1 for vacuum
    mixing : what each material of an object consists of at this instant, as parts by volume; None where that is itself
    """

    objects: tuple[tuple[Shape, int | tuple[int, ...]], ...]
    materials: tuple[Material, ...]
    background: int = -1
    mixing: Float[np.ndarray, "material material"] | None = None

    @cached_property
    def solids(self) -> Solids:
        """The objects as arrays for kernels."""
        return solids_of(self.objects)

    def path_lengths(
        self, origins: Float[np.ndarray, "ray 3"], directions: Float[np.ndarray, "ray 3"]
    ) -> Float[np.ndarray, "ray material"]:
        """Compute exact path lengths of rays in each material.

        Parameters
        ----------
        origins : first points [mm]
        directions : from the first to the last points [mm]

        Returns
        -------
        path lengths [mm]
        """
        lengths = trace(origins, directions, self.solids, len(self.materials), self.background)
        return lengths if self.mixing is None else lengths @ self.mixing

    def fractions(self, grid: Grid) -> Float32[np.ndarray, "material z y x"]:
        """Compute the part of each voxel that each material fills.

        Parameters
        ----------
        grid : the voxels

        Returns
        -------
        parts from 0 to 1
        """
        filled = fractions(grid, self.solids, len(self.materials), background=self.background)
        if self.mixing is None:
            return filled
        return np.tensordot(self.mixing.T.astype(np.float32), filled, axes=1)
