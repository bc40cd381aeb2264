"""Volume in a scene file. Lengths in mm."""

from typing import Annotated

from pydantic import Field, PositiveInt, model_validator

from phantomgen.geometry.schema import Length
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.scene.schema.base import Model, Vector

Voxels = Annotated[PositiveInt, Field(le=8192)]


class VolumeModel(Model):
    """The voxels that truth is given on and that are asked for.

    `size`: edge of a cube, or edges along (x, y, z) [mm]. `voxels`: along the longest edge, where the others have as
    many as make voxels cubic, or along (x, y, z). `slices`: voxels along z of a cube, so many about the middle.
    `center`: position (x, y, z) of the middle [mm].
    """

    voxels: Voxels | tuple[Voxels, Voxels, Voxels]
    size: Length | tuple[Length, Length, Length]
    slices: Voxels | None = None
    center: Vector = (0.0, 0.0, 0.0)

    @model_validator(mode="after")
    def _check(self) -> "VolumeModel":
        """Refuse edges that do not go together."""
        if isinstance(self.voxels, tuple) and not isinstance(self.size, tuple):
            raise ValueError("three numbers of voxels need a size of three edges, (x, y, z) in mm")
        if isinstance(self.size, tuple) and self.slices is not None:
            raise ValueError("slices are those of a cube: leave them out where size has three edges")
        return self

    @property
    def grid(self) -> Grid:
        """The voxels."""
        x, y, z = self.size if isinstance(self.size, tuple) else (self.size, self.size, self.size)
        if isinstance(self.voxels, tuple):
            columns, rows, layers = self.voxels
        else:
            per_mm = self.voxels / max(x, y, z)
            columns, rows, layers = (max(1, round(per_mm * edge)) for edge in (x, y, z))
        spacing = (z / layers, y / rows, x / columns)
        right, front, up = self.center
        origin = (up + (spacing[0] - z) / 2, front + (spacing[1] - y) / 2, right + (spacing[2] - x) / 2)
        if self.slices is None:
            return Grid((layers, rows, columns), spacing, origin)
        lowest = up - spacing[0] * (self.slices - 1) / 2
        return Grid((self.slices, rows, columns), spacing, (lowest, *origin[1:]))
