"""Volume in a scene file. Lengths in mm."""

from pydantic import PositiveFloat, PositiveInt

from phantomgen.scene.schema.base import Model


class VolumeModel(Model):
    """The cube that truth is given on and that is asked for: voxels along each edge, edge length [mm]."""

    voxels: PositiveInt
    size: PositiveFloat
