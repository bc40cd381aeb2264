"""Orbits in a scene file: how source and panel go around the object. Lengths in mm, angles in degrees."""

from typing import Annotated, Literal

from pydantic import Field, FiniteFloat, PositiveFloat, PositiveInt

from phantomgen.scene.schema.base import Model, NonNegative, NonNegativeInt

Tilt = Annotated[FiniteFloat, Field(gt=-90, lt=90)]


class JitterModel(Model):
    """Random displacements, new in every view: standard deviations along, and turns about, each of three axes.

    `source` and `panel` [mm], `rotation` of the panel about its centre [degree].
    """

    source: NonNegative = 0.0
    panel: NonNegative = 0.0
    rotation: Annotated[NonNegative, Field(le=10)] = 0.0


Angles = Annotated[tuple[FiniteFloat, ...], Field(min_length=1)]
Degrees = Annotated[PositiveFloat, Field(le=360)]


class CircularModel(Model):
    """Circular orbit: training views at start + i arc/views degrees, or at `angles`; test views between them.

    Left out, `start` is 0 and `arc` 360; `arc: short` is half a turn and the fan.
    """

    type: Literal["circular"]
    sod: PositiveFloat
    sdd: PositiveFloat
    views: PositiveInt | None = None
    angles: Angles | None = None
    arc: Degrees | Literal["short"] | None = None
    start: FiniteFloat | None = None
    test_views: NonNegativeInt = 0
    jitter: JitterModel | None = None


class HelicalModel(Model):
    """Circular orbit that rises by `pitch` [mm] per turn, for `turns` or over a `range` [mm], its middle at z = 0."""

    type: Literal["helical"]
    sod: PositiveFloat
    sdd: PositiveFloat
    views: PositiveInt
    pitch: FiniteFloat
    turns: PositiveFloat | None = None
    range: PositiveFloat | None = None
    start: FiniteFloat = 0.0
    test_views: NonNegativeInt = 0
    jitter: JitterModel | None = None


class LaminographyModel(Model):
    """Circular orbit whose beam dips by `tilt` below the plane across the rotation axis; distances along the beam."""

    type: Literal["laminography"]
    sod: PositiveFloat
    sdd: PositiveFloat
    tilt: Tilt
    views: PositiveInt | None = None
    angles: Angles | None = None
    arc: Degrees | None = None
    start: FiniteFloat | None = None
    test_views: NonNegativeInt = 0
    jitter: JitterModel | None = None


class ParallelModel(Model):
    """Parallel beam, the panel at a `distance` from the axis; `arc` is 180 if left out, `tilt` as in laminography."""

    type: Literal["parallel"]
    distance: PositiveFloat
    tilt: Tilt = 0.0
    views: PositiveInt | None = None
    angles: Angles | None = None
    arc: Degrees | None = None
    start: FiniteFloat | None = None
    test_views: NonNegativeInt = 0
    jitter: JitterModel | None = None


class PosesModel(Model):
    """Poses from a table (.csv, .npz, .h5), one row per view; evenly picked rows are test views."""

    type: Literal["poses"]
    file: str
    test_views: NonNegativeInt = 0
    jitter: JitterModel | None = None


OrbitModel = Annotated[
    CircularModel | HelicalModel | LaminographyModel | ParallelModel | PosesModel, Field(discriminator="type")
]
