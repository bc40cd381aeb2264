"""Motions of objects from a scene file, and the form of objects that bend."""

import numpy as np

from phantomgen.scene import schema
from phantomgen.scene.dynamics.lattice import Lattice
from phantomgen.scene.dynamics.object_motion import Motions, ObjectMotion, bends
from phantomgen.scene.file.scene_file import Location, SceneFile, closest
from phantomgen.shapes import Shape
from phantomgen.shapes.surfaces import surface_of


def motion_of(file: SceneFile, model: schema.ObjectMotionModel, center: schema.Vector, where: Location) -> ObjectMotion:
    """Create the motion of an object.

    Parameters
    ----------
    file : the scene file
    model : the motion there
    center : of the object [mm]
    where : place of the object in the file

    Returns
    -------
    the motion

    Raises
    ------
    SceneError
        When the scene has no such signal.
    """
    signals = {} if file.model.time is None else file.model.time.signals
    if model.signal not in signals:
        hint = closest(model.signal, signals) if signals else ": give it below time.signals"
        raise file.error((*where, "motion", "signal"), f"there is no signal {model.signal!r}{hint}")
    sizes = np.broadcast_to(np.asarray(model.scale, dtype=np.float64), 3)
    (x, y, z), (a, b, c) = sizes.tolist(), np.radians(model.rotation).tolist()
    return ObjectMotion(
        signal=model.signal,
        pivot=center if model.pivot is None else model.pivot,
        shift=model.shift,
        rotation=(a, b, c),
        scale=(x, y, z),
        path=model.path or (),
        lattice=None if model.deform is None else _lattice(model.deform),
    )


def form_of(shape: Shape, motion: ObjectMotion, fineness: int) -> Shape:
    """Return an object as a surface of triangles where a motion bends it.

    Parameters
    ----------
    shape : at rest
    motion : of the object
    fineness : of the triangles

    Returns
    -------
    the surface; the shape itself where it keeps its form
    """
    return surface_of(shape, fineness) if bends((motion,)) else shape


def check_form(shape: Shape, motions: Motions) -> None:
    """Refuse a shape that cannot bend and would have to.

    Parameters
    ----------
    shape : at rest
    motions : of the object and of its groups

    Raises
    ------
    InputError
        When it cannot.
    """
    if bends(motions):
        surface_of(shape)


def _lattice(model: schema.LatticeModel) -> Lattice:
    """The displacements of a deformation."""
    return Lattice(np.array(model.low), np.array(model.high), np.array(model.shifts, dtype=np.float64))
