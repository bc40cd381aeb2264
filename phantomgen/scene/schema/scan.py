"""Panel and volume in a scene file. Lengths in mm, angles in degrees."""

from typing import Annotated

from pydantic import Field, FiniteFloat, PositiveFloat, PositiveInt

from phantomgen.scene.schema.base import Model
from phantomgen.scene.schema.orbits import Tilt


class OffsetModel(Model):
    """Shift of the panel in its plane, the way columns count and the way rows count [mm]."""

    columns: FiniteFloat = 0.0
    rows: FiniteFloat = 0.0


class TiltModel(Model):
    """Turns of the panel: about the direction of its columns' steps, of its rows' steps, and in its plane [degree]."""

    columns: Tilt = 0.0
    rows: Tilt = 0.0
    in_plane: Annotated[FiniteFloat, Field(ge=-180, le=180)] = 0.0


class PanelModel(Model):
    """The pixel grid; one pitch [mm] for square pixels, else (between rows, between columns).

    Pixels average over their area, split along silhouettes; `sub_rays` takes a plain grid of so many rays along each
    edge of a pixel instead, faster and less exact, and 1 takes the ray through the centre alone.
    """

    rows: PositiveInt
    columns: PositiveInt
    pitch: PositiveFloat | tuple[PositiveFloat, PositiveFloat]
    offset: OffsetModel | None = None
    tilt: TiltModel | None = None
    sub_rays: Annotated[int, Field(ge=1, le=16)] | None = None


class VolumeModel(Model):
    """The cube that truth is given on and that is asked for: voxels along each edge, edge length [mm]."""

    voxels: PositiveInt
    size: PositiveFloat
