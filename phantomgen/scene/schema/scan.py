"""Volume in a scene file. Lengths in mm."""

from typing import Annotated

from pydantic import Field, PositiveInt

from phantomgen.geometry.schema import Length
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.scene.schema.base import Model


class VolumeModel(Model):
    """The voxels that truth is given on and that are asked for, a cube or some of its slices about the middle.

    Voxels along each edge of the cube, its edge [mm], and voxels along z where they are not as many.
    """

    voxels: Annotated[PositiveInt, Field(le=8192)]
    size: Length
    slices: Annotated[PositiveInt, Field(le=8192)] | None = None

    @property
    def grid(self) -> Grid:
        """The voxels."""
        cube = Grid.cube(self.voxels, self.size)
        if self.slices is None:
            return cube
        lowest = -cube.spacing[0] * (self.slices - 1) / 2
        return Grid((self.slices, *cube.shape[1:]), cube.spacing, (lowest, *cube.origin[1:]))
