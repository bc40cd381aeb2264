"""Volume in a scene file. Lengths in mm."""

from typing import Annotated

from pydantic import Field, PositiveInt

from phantomgen.geometry.schema import Length
from phantomgen.scene.schema.base import Model


class VolumeModel(Model):
    """The cube that truth is given on and that is asked for: voxels along each edge, edge length [mm]."""

    voxels: Annotated[PositiveInt, Field(le=8192)]
    size: Length
