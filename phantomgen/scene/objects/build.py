"""From object models of a scene file to shapes with the names of their materials."""

from collections.abc import Iterator
from itertools import product
from math import prod, radians
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from phantomgen.scene import schema
from phantomgen.scene.file.random_values import MOST_OBJECTS
from phantomgen.scene.file.scene_file import Location, SceneFile
from phantomgen.scene.materials import check_material
from phantomgen.scene.objects.voxel_maps import voxels_of
from phantomgen.shapes import (
    Box,
    Capsule,
    Cone,
    Cylinder,
    Difference,
    Ellipsoid,
    HalfSpace,
    Intersection,
    Placed,
    Polygon,
    Shape,
    Sphere,
    Torus,
    Tube,
    Union,
    is_cad,
    load_mesh,
    rotation_matrix,
    sweep,
)

if TYPE_CHECKING:
    from phantomgen.scene.dynamics.object_motion import Motions

# Name of an object's material; of a voxel map those of its parts.
ObjectContent = str | tuple[str, ...]


class BuiltObject(NamedTuple):
    """An object as it is at rest, and how it moves.

    Parameters
    ----------
    shape : at rest
    content : name of its material; of a voxel map those of its parts
    motions : its own and those of its groups; none where it rests
    """

    shape: Shape
    content: ObjectContent
    motions: "Motions" = ()

    def placed(self, matrix: np.ndarray, offset: np.ndarray) -> "BuiltObject":
        """Move the object, and its motions with it: every point x goes to ``matrix @ x + offset``.

        Parameters
        ----------
        matrix : (3, 3)
        offset : [mm]

        Returns
        -------
        the moved object
        """
        frame = np.eye(4)
        frame[:3, :3], frame[:3, 3] = matrix, offset
        motions = tuple(motion.within(frame) for motion in self.motions)
        return BuiltObject(Placed(self.shape, matrix, offset), self.content, motions)


def objects_of(file: SceneFile) -> list[BuiltObject]:
    """Create the objects, lowest priority first, groups and patterns resolved.

    Parameters
    ----------
    file : the scene file

    Returns
    -------
    the objects

    Raises
    ------
    SceneError
        With the place in the file of a material that is missing, unknown or out of place, or of an impossible shape.
    """
    if sum(map(_count, file.model.objects)) > MOST_OBJECTS:
        raise file.error(("objects",), f"has more than {MOST_OBJECTS} objects with all copies, the most that are read")
    return list(_members(file, file.model.objects, ("objects",)))


def _count(model: schema.ObjectModel) -> int:
    """Number of shapes that an object stands for, with all copies."""
    match model:
        case schema.GroupModel():
            parts = model.objects
        case schema.CombinedModel():
            parts = model.shapes
        case schema.DifferenceModel():
            parts = (model.base, *model.cut)
        case _:
            parts = ()
    match model.repeat:
        case schema.RingModel(count=count):
            copies = count
        case schema.GridModel(count=counts):
            copies = prod(counts)
        case _:
            copies = 1
    return copies * max(sum(map(_count, parts)), 1)


def _members(file: SceneFile, models: tuple[schema.ObjectModel, ...], where: Location) -> Iterator[BuiltObject]:
    """Objects of the scene or of a group."""
    for i, model in enumerate(models):
        place = (*where, i)
        if isinstance(model, schema.GroupModel):
            found = list(_group(file, model, place))
        elif isinstance(model, schema.VoxelsModel):
            _refuse_material(file, model, place)
            shape, materials = voxels_of(file, model, place)
            with file.at(*place):
                found = [BuiltObject(_clipped(shape, model), materials)]
        else:
            found = [BuiltObject(_shape(file, model, place), _material(file, model, place))]
        if model.motion is not None:
            from phantomgen.scene.objects.motion import form_of, motion_of  # noqa: PLC0415 - only where something moves

            motion = motion_of(file, model.motion, _center(model, found), place)
            with file.at(*place, "motion", "deform"):
                forms = [form_of(item.shape, motion, _fineness(file)) for item in found]
            found = [
                item._replace(shape=s, motions=(*item.motions, motion)) for item, s in zip(found, forms, strict=True)
            ]
        for copy in _copies(model):
            yield from map(copy, found)


def _center(model: schema.ObjectModel, found: list[BuiltObject]) -> schema.Vector:
    """Centre of an object; of a voxel map without one, the middle of its bounds."""
    if model.center is not None:
        return model.center
    low, high = found[0].shape.bounds
    x, y, z = ((low + high) / 2).tolist()
    return x, y, z


def _group(file: SceneFile, model: schema.GroupModel, where: Location) -> Iterator[BuiltObject]:
    """Members of a group where they belong."""
    _refuse_material(file, model, where)
    scale = np.broadcast_to(np.asarray(model.scale, dtype=np.float64), 3)
    matrix = rotation_matrix(_radians(model.rotation)) * scale
    for member in _members(file, model.objects, (*where, "objects")):
        placed = member.placed(matrix, np.asarray(model.center))
        if not any(_sides(placed.shape, plane)[0] for plane in model.clip):
            clipped = _clipped(placed.shape, model)
            if placed.motions:
                from phantomgen.scene.objects.motion import check_form  # noqa: PLC0415 - only where something moves

                with file.at(*where, "clip"):
                    check_form(clipped, placed.motions)
            yield placed._replace(shape=clipped)


def _material(file: SceneFile, model: schema.ObjectModel, where: Location) -> str:
    """Name of an object's material."""
    if model.material is None:
        raise file.error((*where, "material"), "is missing")
    check_material(file, model.material, (*where, "material"))
    return model.material


def _refuse_material(file: SceneFile, model: schema.ObjectModel, where: Location) -> None:
    """Refuse a material where it would mean nothing."""
    if model.material is not None:
        raise file.error((*where, "material"), "belongs to the whole object, or to the members of a group")


def has_curves(file: SceneFile) -> bool:
    """Return whether a scene has smooth surfaces that become triangles: sweeps, or CAD files.

    Parameters
    ----------
    file : the scene file

    Returns
    -------
    True where there are some
    """
    return any(map(_curved, file.model.objects))


def _curved(model: schema.ObjectModel) -> bool:
    """Return whether an object, or a part of it, is a smooth surface that becomes triangles."""
    if isinstance(model, schema.SweepModel) or (model.motion is not None and model.motion.deform is not None):
        return True
    match model:
        case schema.MeshModel():
            return is_cad(model.file)
        case schema.GroupModel():
            return any(map(_curved, model.objects))
        case schema.CombinedModel():
            return any(map(_curved, model.shapes))
        case schema.DifferenceModel():
            return any(map(_curved, (model.base, *model.cut)))
    return False


def _fineness(file: SceneFile) -> int:
    """Return how many times finer than usual smooth surfaces become triangles."""
    wanted = file.model.tessellation
    return wanted if isinstance(wanted, int) else 1


def _part(file: SceneFile, model: schema.ObjectModel, where: Location) -> Shape:
    """A shape that another one is combined from."""
    if isinstance(model, schema.GroupModel):
        raise file.error((*where, "type"), "a group cannot be combined with shapes: use a union")
    if isinstance(model, schema.VoxelsModel):
        raise file.error((*where, "type"), "voxels cannot be combined with shapes: they bring materials of their own")
    _refuse_material(file, model, where)
    if model.motion is not None:
        raise file.error((*where, "motion"), "belongs to the whole object, or to the members of a group")
    whole = BuiltObject(_shape(file, model, where), "")
    copies = [copy(whole).shape for copy in _copies(model)]
    return copies[0] if len(copies) == 1 else Union(tuple(copies))


def _parts(file: SceneFile, models: tuple[schema.ObjectModel, ...], where: Location) -> tuple[Shape, ...]:
    return tuple(_part(file, model, (*where, i)) for i, model in enumerate(models))


def _shape(file: SceneFile, model: schema.ObjectModel, where: Location) -> Shape:
    """One shape with what is cut off."""
    shift = np.asarray(model.center)
    if isinstance(model, schema.CombinedModel):
        parts = _parts(file, model.shapes, (*where, "shapes"))
        shape = Placed((Union if model.type == "union" else Intersection)(parts), np.eye(3), shift)
    elif isinstance(model, schema.DifferenceModel):
        base = _part(file, model.base, (*where, "base"))
        shape = Placed(Difference(base, _parts(file, model.cut, (*where, "cut"))), np.eye(3), shift)
    else:
        with file.at(*where):
            shape = _mesh(file, model) if isinstance(model, schema.MeshModel) else _simple(model, _fineness(file))
    with file.at(*where):
        shape = _clipped(shape, model)
        _ = shape.terms  # refuses what falls into too many pieces
        return shape


def _mesh(file: SceneFile, model: schema.MeshModel) -> Shape:
    """A mesh from a file beside the scene."""
    mesh = load_mesh(Path(file.name).parent / model.file, model.unit, model.file, _fineness(file))
    scale = np.broadcast_to(np.asarray(model.scale, dtype=np.float64), 3)
    return Placed(mesh, rotation_matrix(_radians(model.rotation)) * scale, np.asarray(model.center))


def _simple(m: schema.ObjectModel, fineness: int) -> Shape:  # noqa: PLR0911 - one line per type
    """A shape that is not made of others."""
    match m:
        case schema.SphereModel():
            return Sphere(m.center, m.radius)
        case schema.EllipsoidModel():
            return Ellipsoid(m.center, m.radii, _radians(m.rotation))
        case schema.CylinderModel():
            return Cylinder(m.center, m.radius, m.length, m.axis)
        case schema.BoxModel():
            return Box(m.center, m.size, _radians(m.rotation))
        case schema.TubeShapeModel():
            return Tube(m.center, m.radius, m.inner_radius, m.length, m.axis)
        case schema.CapsuleModel():
            return Capsule(m.center, m.radius, m.length, m.axis)
        case schema.ConeModel():
            return Cone(m.center, m.radii, m.length, m.axis)
        case schema.TorusModel():
            return Torus(m.center, m.radius, m.tube, m.axis)
        case schema.PolygonModel():
            return Polygon(m.points, m.length, m.center, _radians(m.rotation))
        case schema.SweepModel():
            tube = sweep(m.points, m.radius, m.sides * fineness, m.steps * fineness)
            return Placed(tube, np.eye(3), np.asarray(m.center))
    raise AssertionError(type(m))


def _clipped(shape: Shape, model: schema.ObjectModel) -> Shape:
    """The part of a shape below all of the model's planes; those that do not reach it are left out."""
    cutting = [plane for plane in model.clip if not _sides(shape, plane)[1]]
    if not cutting:
        return shape
    return Intersection((shape, *(HalfSpace(plane.normal, plane.offset) for plane in cutting)))


def _sides(shape: Shape, plane: schema.PlaneModel) -> tuple[bool, bool]:
    """Whether the bounds of a shape lie beyond a plane, and whether they lie below it."""
    low, high = shape.bounds
    normal = np.asarray(plane.normal)
    nearest, farthest = (float(np.where(normal > 0, a, b) @ normal) for a, b in ((low, high), (high, low)))
    return bool(normal.any()) and nearest >= plane.offset, farthest < plane.offset


def _copies(model: schema.ObjectModel):
    """Functions that put an object at each place of the model's pattern."""
    pattern = model.repeat
    if pattern is None:
        return [lambda item: item]
    if isinstance(pattern, schema.RingModel):
        turns = [rotation_matrix((0.0, 0.0, 2 * np.pi * i / pattern.count)) for i in range(pattern.count)]
        return [lambda item, turn=turn: item.placed(turn, np.zeros(3)) for turn in turns]
    places = product(
        *((np.arange(n) - (n - 1) / 2) * step for n, step in zip(pattern.count, pattern.step, strict=True))
    )
    return (lambda item, place=place: item.placed(np.eye(3), np.array(place)) for place in places)


def _radians(degrees: schema.Vector) -> schema.Vector:
    """Three angles [rad]."""
    x, y, z = (radians(angle) for angle in degrees)
    return x, y, z
