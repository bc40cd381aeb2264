"""Objects in a scene file. Lengths in mm, angles in degrees."""

from typing import Annotated, Literal

from pydantic import Field, FiniteFloat, PositiveFloat, PositiveInt

from phantomgen.scene.schema.base import NonNegative, Size, Vector
from phantomgen.scene.schema.bodies import HeadModel, TorsoModel
from phantomgen.scene.schema.common import ObjectModel


class SphereModel(ObjectModel):
    """A ball."""

    type: Literal["sphere"]
    radius: PositiveFloat


class EllipsoidModel(ObjectModel):
    """Half axes [mm] along x, y, z, turned about x, then y, then z [degree]."""

    type: Literal["ellipsoid"]
    radii: Size
    rotation: Vector = (0.0, 0.0, 0.0)


class CylinderModel(ObjectModel):
    """A capped cylinder along any axis; one radius, or two for an elliptic one."""

    type: Literal["cylinder"]
    radius: PositiveFloat | tuple[PositiveFloat, PositiveFloat]
    length: PositiveFloat
    axis: Vector = (0.0, 0.0, 1.0)


class BoxModel(ObjectModel):
    """Full edge lengths [mm] along x, y, z, turned about x, then y, then z [degree]."""

    type: Literal["box"]
    size: Size
    rotation: Vector = (0.0, 0.0, 0.0)


class TubeShapeModel(ObjectModel):
    """A circular cylinder with a coaxial bore."""

    type: Literal["tube"]
    radius: PositiveFloat
    inner_radius: PositiveFloat
    length: PositiveFloat
    axis: Vector = (0.0, 0.0, 1.0)


class CapsuleModel(ObjectModel):
    """A circular cylinder with half balls on its ends; the length is that of the straight part."""

    type: Literal["capsule"]
    radius: PositiveFloat
    length: PositiveFloat
    axis: Vector = (0.0, 0.0, 1.0)


class ConeModel(ObjectModel):
    """A cone, or a frustum: radii at the beginning and at the end of the axis, one of which may be 0."""

    type: Literal["cone"]
    radii: tuple[NonNegative, NonNegative]
    length: PositiveFloat
    axis: Vector = (0.0, 0.0, 1.0)


class TorusModel(ObjectModel):
    """A ring: radius to the middle of the tube, radius of the tube, normal of its plane."""

    type: Literal["torus"]
    radius: PositiveFloat
    tube: PositiveFloat
    axis: Vector = (0.0, 0.0, 1.0)


class PolygonModel(ObjectModel):
    """A simple polygon with corners (x, y) [mm], drawn out along z, turned about x, then y, then z [degree]."""

    type: Literal["polygon"]
    points: Annotated[tuple[tuple[FiniteFloat, FiniteFloat], ...], Field(min_length=3)]
    length: PositiveFloat
    rotation: Vector = (0.0, 0.0, 0.0)


class MeshModel(ObjectModel):
    """A closed mesh: STL, OBJ, PLY, GLB, 3MF or STEP file, scaled, turned (about x, then y, then z; degrees) and moved.

    A relative path starts at the folder of the scene file.
    """

    type: Literal["mesh"]
    file: str
    unit: Literal["mm", "cm", "m", "um", "inch"]
    rotation: Vector = (0.0, 0.0, 0.0)
    scale: PositiveFloat | Size = 1.0


class SweepModel(ObjectModel):
    """A round tube along a smooth curve: points that it passes, one radius [mm] or one per point.

    It is a mesh, with so many corners around and so many rings from point to point.
    """

    type: Literal["sweep"]
    points: Annotated[tuple[Vector, ...], Field(min_length=2)]
    radius: PositiveFloat | tuple[PositiveFloat, ...]
    sides: Annotated[int, Field(ge=3, le=10_000)] = 24
    steps: Annotated[PositiveInt, Field(le=10_000)] = 8


class VoxelsModel(ObjectModel):
    """A box of voxels from a file: labels, volume fractions, or Hounsfield units, and the materials they stand for.

    Spacing [mm] along x, y and z, and the centre, are the file's own unless given; turned about x, then y, then z
    [degree]. Voxels without material are background. A relative path starts at the folder of the scene file. Labels
    may be those of a program; ``relabel`` then names other materials of some.
    """

    type: Literal["voxels"]
    file: str | None = None
    labels: Literal["totalsegmentator"] | dict[int, str | None] | None = None
    relabel: dict[int, str | None] | None = None
    fractions: dict[str, str] | tuple[str, ...] | None = None
    hu: Literal["default"] | Annotated[dict[str, tuple[FiniteFloat, FiniteFloat]], Field(min_length=1)] | None = None
    spacing: PositiveFloat | Size | None = None
    center: Vector | None = None  # type: ignore[assignment]
    rotation: Vector = (0.0, 0.0, 0.0)


class CombinedModel(ObjectModel):
    """Union (points in any) or intersection (points in all) of some shapes."""

    type: Literal["union", "intersection"]
    shapes: Annotated[tuple["ShapeModel", ...], Field(min_length=1)]


class DifferenceModel(ObjectModel):
    """Difference: points in a shape and in none of those that are cut off."""

    type: Literal["difference"]
    base: "ShapeModel"
    cut: Annotated[tuple["ShapeModel", ...], Field(min_length=1)]


class GroupModel(ObjectModel):
    """Objects that are scaled, then turned about x, then y, then z [degree], then moved to the centre, together."""

    type: Literal["group"]
    objects: Annotated[tuple["ShapeModel", ...], Field(min_length=1)]
    rotation: Vector = (0.0, 0.0, 0.0)
    scale: PositiveFloat | Size = 1.0


ShapeModel = Annotated[
    SphereModel
    | EllipsoidModel
    | CylinderModel
    | BoxModel
    | TubeShapeModel
    | CapsuleModel
    | ConeModel
    | TorusModel
    | PolygonModel
    | MeshModel
    | SweepModel
    | VoxelsModel
    | CombinedModel
    | DifferenceModel
    | GroupModel
    | TorsoModel
    | HeadModel,
    Field(discriminator="type"),
]
