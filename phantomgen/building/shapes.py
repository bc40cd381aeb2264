"""Objects of a scene in Python: each takes the keys that an object of its type has in a scene file.

Lengths in mm, angles in degrees. Values are checked at once, with the sentences of scene files.
"""

from typing import Any, Literal

from pydantic import ValidationError

from phantomgen.scene import schema
from phantomgen.scene.file.scene_file import validation_sentence
from spectra.errors import SceneError


class Described(schema.ObjectModel):
    """Common keys: the name of a material, the centre (x, y, z) [mm], planes that cut, and a pattern of copies.

    Parameters
    ----------
    **values : keys of the object in a scene file

    Raises
    ------
    SceneError
        With the key of what is wrong.
    """

    def __init__(self, **values: Any) -> None:
        try:
            super().__init__(**values)
        except ValidationError as error:
            sentence = validation_sentence(error, type(self).__name__.lower(), values)
            raise SceneError(f"{type(self).__name__}: {sentence}") from None
        self.model_fields_set.add("type")

    @property
    def values(self) -> dict[str, Any]:
        """The object as the mapping that a scene file has."""
        data = self.model_dump(mode="json", exclude_unset=True)
        return {"type": data.pop("type"), **data}

    def __repr_args__(self) -> Any:
        """Return the values that were given."""
        return [(name, value) for name, value in super().__repr_args__() if name in self.model_fields_set - {"type"}]


class Sphere(Described, schema.SphereModel):
    """A ball."""

    type: Literal["sphere"] = "sphere"  # pyright: ignore


class Ellipsoid(Described, schema.EllipsoidModel):
    """Half axes [mm] along x, y, z, turned about x, then y, then z [degree]."""

    type: Literal["ellipsoid"] = "ellipsoid"  # pyright: ignore


class Cylinder(Described, schema.CylinderModel):
    """A capped cylinder along any axis; one radius, or two for an elliptic one."""

    type: Literal["cylinder"] = "cylinder"  # pyright: ignore


class Box(Described, schema.BoxModel):
    """Full edge lengths [mm] along x, y, z, turned about x, then y, then z [degree]."""

    type: Literal["box"] = "box"  # pyright: ignore


class Tube(Described, schema.TubeShapeModel):
    """A circular cylinder with a coaxial bore."""

    type: Literal["tube"] = "tube"  # pyright: ignore


class Capsule(Described, schema.CapsuleModel):
    """A circular cylinder with half balls on its ends; the length is that of the straight part."""

    type: Literal["capsule"] = "capsule"  # pyright: ignore


class Cone(Described, schema.ConeModel):
    """A cone, or a frustum: radii at the beginning and at the end of the axis, one of which may be 0."""

    type: Literal["cone"] = "cone"  # pyright: ignore


class Torus(Described, schema.TorusModel):
    """A ring: radius to the middle of the tube, radius of the tube, normal of its plane."""

    type: Literal["torus"] = "torus"  # pyright: ignore


class Polygon(Described, schema.PolygonModel):
    """A simple polygon with corners (x, y) [mm], drawn out along z, turned about x, then y, then z [degree]."""

    type: Literal["polygon"] = "polygon"  # pyright: ignore


class Mesh(Described, schema.MeshModel):
    """A closed mesh: STL, OBJ, PLY, GLB, 3MF or STEP file, scaled, turned (about x, then y, then z; degrees) and moved.

    A relative path starts at the folder of the scene file.
    """

    type: Literal["mesh"] = "mesh"  # pyright: ignore


class Sweep(Described, schema.SweepModel):
    """A round tube along a smooth curve: points that it passes, one radius [mm] or one per point.

    It is a mesh, with so many corners around and so many rings from point to point.
    """

    type: Literal["sweep"] = "sweep"  # pyright: ignore


class Voxels(Described, schema.VoxelsModel):
    """A box of voxels from a file: labels, volume fractions, or Hounsfield units, and the materials they stand for.

    Spacing [mm] along x, y and z, and the centre, are the file's own unless given; turned about x, then y, then z
    [degree]. Voxels without material are background. A relative path starts at the folder of the scene file.
    """

    type: Literal["voxels"] = "voxels"  # pyright: ignore


class Union(Described, schema.CombinedModel):
    """Union of shapes: points in any of them."""

    type: Literal["union"] = "union"  # pyright: ignore


class Intersection(Described, schema.CombinedModel):
    """Intersection of shapes: points in all of them."""

    type: Literal["intersection"] = "intersection"  # pyright: ignore


class Difference(Described, schema.DifferenceModel):
    """Difference: points in a shape and in none of those that are cut off."""

    type: Literal["difference"] = "difference"  # pyright: ignore


class Group(Described, schema.GroupModel):
    """Objects that are scaled, then turned about x, then y, then z [degree], then moved to the centre, together."""

    type: Literal["group"] = "group"  # pyright: ignore


class Torso(Described, schema.TorsoModel):
    """A torso from the shoulders to the kidneys: x points to its left, y to its back, z to its head."""

    type: Literal["torso"] = "torso"  # pyright: ignore


class Head(Described, schema.HeadModel):
    """A head with its neck: x points to its left, y to its back, z to its top."""

    type: Literal["head"] = "head"  # pyright: ignore


for _kind in (Union, Intersection, Difference, Group):
    _kind.model_rebuild(_types_namespace={"ShapeModel": schema.ShapeModel})  # named before it exists
