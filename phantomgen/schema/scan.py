"""Orbit, panel and volume in a scene file. Lengths in mm, angles in degrees."""

from typing import Annotated, Literal

from pydantic import Field, PositiveFloat, PositiveInt

from phantomgen.schema.base import Model, NonNegativeInt


class CircularModel(Model):
    """Circular orbit: training views at i 360/views degrees, test views at (j + 1/2) 360/test_views degrees."""

    type: Literal["circular"]
    sod: PositiveFloat
    sdd: PositiveFloat
    views: PositiveInt
    test_views: NonNegativeInt = 0


class PanelModel(Model):
    """The pixel grid; one pitch [mm] for square pixels, else (between rows, between columns).

    Pixels average over their area, split along silhouettes; `sub_rays` takes a plain grid of so many rays along each
    edge of a pixel instead, faster and less exact, and 1 takes the ray through the centre alone.
    """

    rows: PositiveInt
    columns: PositiveInt
    pitch: PositiveFloat | tuple[PositiveFloat, PositiveFloat]
    sub_rays: Annotated[int, Field(ge=1, le=16)] | None = None


class VolumeModel(Model):
    """The cube that truth is given on and that is asked for: voxels along each edge, edge length [mm]."""

    voxels: PositiveInt
    size: PositiveFloat
