"""Orbit and panel in a scene file, or in a file of views alone, as models that are checked key by key.

Lengths in mm, angles in degrees.
"""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, PositiveFloat, PositiveInt

NonNegative = Annotated[FiniteFloat, Field(ge=0)]
NonNegativeInt = Annotated[int, Field(ge=0)]
Tilt = Annotated[FiniteFloat, Field(gt=-90, lt=90)]


# Limits of lengths [mm] and numbers, far beyond any scan: more would overflow, or fill any memory.
Length = Annotated[PositiveFloat, Field(le=1e7)]
Views = Annotated[PositiveInt, Field(le=1_000_000)]
Pixels = Annotated[PositiveInt, Field(le=100_000)]


class Model(BaseModel):
    """Common settings: immutable, no unknown keys."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class JitterModel(Model):
    """Random displacements, new in every view: standard deviations along, and turns about, each of three axes.

    `source` and `panel` [mm], `rotation` of the panel about its centre [degree].
    """

    source: NonNegative = 0.0
    panel: NonNegative = 0.0
    rotation: Annotated[NonNegative, Field(le=10)] = 0.0


Angles = Annotated[tuple[FiniteFloat, ...], Field(min_length=1)]
Degrees = Annotated[PositiveFloat, Field(le=360)]
SeveralTurns = Annotated[PositiveFloat, Field(le=36_000)]


class DeflectionModel(Model):
    """Deflection of the focal spot: along the way columns count, along z, and away from the rotation axis [mm]."""

    columns: FiniteFloat = 0.0
    z: FiniteFloat = 0.0
    outward: FiniteFloat = 0.0


# Of a flying focal spot: view i has deflection i modulo their number, and so has test view i.
Deflections = Annotated[tuple[DeflectionModel, ...], Field(min_length=1)]


class CircularModel(Model):
    """Circular orbit: training views at start + i arc/views degrees, or at `angles`; test views between them.

    Left out, `start` is 0 and `arc` 360; `arc: short` is half a turn and the fan; several turns, of use where objects
    move, take more than 360. `flying_focal_spot` lists deflections of the source that views take in turn, while the
    panel stays.
    """

    type: Literal["circular"]
    sod: Length
    sdd: Length
    views: Views | None = None
    angles: Angles | None = None
    arc: SeveralTurns | Literal["short"] | None = None
    start: FiniteFloat | None = None
    test_views: Annotated[NonNegativeInt, Field(le=1_000_000)] = 0
    jitter: JitterModel | None = None
    flying_focal_spot: Deflections | None = None


class HelicalModel(Model):
    """Circular orbit that rises by `pitch` [mm] per turn, for `turns` or over a `range` [mm], its middle at z = 0.

    `flying_focal_spot` lists deflections of the source that views take in turn, while the panel stays.
    """

    type: Literal["helical"]
    sod: Length
    sdd: Length
    views: Views
    pitch: FiniteFloat
    turns: PositiveFloat | None = None
    range: PositiveFloat | None = None
    start: FiniteFloat = 0.0
    test_views: Annotated[NonNegativeInt, Field(le=1_000_000)] = 0
    jitter: JitterModel | None = None
    flying_focal_spot: Deflections | None = None


class LaminographyModel(Model):
    """Circular orbit whose beam dips by `tilt` below the plane across the rotation axis; distances along the beam."""

    type: Literal["laminography"]
    sod: Length
    sdd: Length
    tilt: Tilt
    views: Views | None = None
    angles: Angles | None = None
    arc: Degrees | None = None
    start: FiniteFloat | None = None
    test_views: Annotated[NonNegativeInt, Field(le=1_000_000)] = 0
    jitter: JitterModel | None = None


class ParallelModel(Model):
    """Parallel beam, the panel at a `distance` from the axis; `arc` is 180 if left out, `tilt` as in laminography."""

    type: Literal["parallel"]
    distance: Length
    tilt: Tilt = 0.0
    views: Views | None = None
    angles: Angles | None = None
    arc: Degrees | None = None
    start: FiniteFloat | None = None
    test_views: Annotated[NonNegativeInt, Field(le=1_000_000)] = 0
    jitter: JitterModel | None = None


class PosesModel(Model):
    """Poses from a table (.csv, .npz, .h5), one row per view; evenly picked rows are test views."""

    type: Literal["poses"]
    file: str
    test_views: Annotated[NonNegativeInt, Field(le=1_000_000)] = 0
    jitter: JitterModel | None = None


OrbitModel = Annotated[
    CircularModel | HelicalModel | LaminographyModel | ParallelModel | PosesModel, Field(discriminator="type")
]


class OffsetModel(Model):
    """Shift of the panel in its plane, the way columns count and the way rows count [mm]."""

    columns: FiniteFloat = 0.0
    rows: FiniteFloat = 0.0


class TiltModel(Model):
    """Turns of the panel: about the direction of its columns' steps, of its rows' steps, and in its plane [degree]."""

    columns: Tilt = 0.0
    rows: Tilt = 0.0
    in_plane: Annotated[FiniteFloat, Field(ge=-180, le=180)] = 0.0


class CurvatureModel(Model):
    """Cylinder that the panel's flat modules touch, its axis along the columns of pixels, on the source's side.

    `radius` [mm], the distance to the source for a scanner with equal angles between columns; `module_columns`, columns
    of a module, or the most that keep pixels within 0.01 pixels of the cylinder.
    """

    radius: Length
    module_columns: Pixels | None = None


class PanelModel(Model):
    """The pixel grid; one pitch [mm] for square pixels, else (between rows, between columns).

    Pixels average over their area, split along silhouettes; `sub_rays` takes a plain grid of so many rays along each
    edge of a pixel instead, faster and less exact, and 1 takes the ray through the centre alone.
    """

    rows: Pixels
    columns: Pixels
    pitch: Length | tuple[Length, Length]
    offset: OffsetModel | None = None
    tilt: TiltModel | None = None
    curvature: CurvatureModel | None = None
    sub_rays: Annotated[int, Field(ge=1, le=16)] | None = None
