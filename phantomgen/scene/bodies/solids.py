"""Objects of a scene as plain mappings, written in few words. Lengths in mm, angles in degrees."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

Object = dict[str, Any]
Point = Sequence[float]
_DIGITS = 4


def _numbers(values: Sequence[float]) -> list[float]:
    """Numbers as a scene file shows them."""
    return [round(float(value), _DIGITS) for value in values]


def ellipsoid(material: str, center: Point, radii: Point, rotation: Point = (0, 0, 0)) -> Object:
    """Create an ellipsoid.

    Parameters
    ----------
    material : name of its material
    center : [mm]
    radii : half axes [mm]
    rotation : about x, then y, then z [degree]

    Returns
    -------
    the object
    """
    found = {"type": "ellipsoid", "material": material, "center": _numbers(center), "radii": _numbers(radii)}
    return found | ({"rotation": _numbers(rotation)} if any(rotation) else {})


def ball(material: str, center: Point, radius: float) -> Object:
    """Create a ball.

    Parameters
    ----------
    material : name of its material
    center : [mm]
    radius : [mm]

    Returns
    -------
    the object
    """
    return {"type": "sphere", "material": material, "center": _numbers(center), "radius": round(radius, _DIGITS)}


def column(material: str, center: Point, radii: Point | float, length: float) -> Object:
    """Create a cylinder along z.

    Parameters
    ----------
    material : name of its material
    center : [mm]
    radii : one radius, or those along x and y [mm]
    length : along z [mm]

    Returns
    -------
    the object
    """
    radius = round(radii, _DIGITS) if isinstance(radii, float | int) else _numbers(radii)
    place = {"center": _numbers(center), "radius": radius, "length": round(length, _DIGITS)}
    return {"type": "cylinder", "material": material, **place}


def rod(material: str, start: Point, end: Point, radius: float) -> Object:
    """Create a cylinder with half balls on its ends.

    Parameters
    ----------
    material : name of its material
    start, end : of its axis [mm]
    radius : [mm]

    Returns
    -------
    the object
    """
    axis = [b - a for a, b in zip(start, end, strict=True)]
    length = sum(step**2 for step in axis) ** 0.5
    center = [(a + b) / 2 for a, b in zip(start, end, strict=True)]
    place = {"center": _numbers(center), "radius": round(radius, _DIGITS), "length": round(length, _DIGITS)}
    return {"type": "capsule", "material": material, **place, "axis": _numbers(axis)}


def chain(material: str, points: Sequence[Point], radius: float) -> list[Object]:
    """Create rods from point to point, with balls where they meet.

    Parameters
    ----------
    material : name of their material
    points : two at least [mm]
    radius : [mm]

    Returns
    -------
    the objects
    """
    found = []
    for start, end in pairwise(points):
        axis = [b - a for a, b in zip(start, end, strict=True)]
        center = [(a + b) / 2 for a, b in zip(start, end, strict=True)]
        straight = column(material, center, radius, sum(step**2 for step in axis) ** 0.5)
        found += [{**straight, "axis": _numbers(axis)}, ball(material, end, radius)]
    return [*found, ball(material, points[0], radius)]


def block(material: str, center: Point, size: Point, rotation: Point = (0, 0, 0)) -> Object:
    """Create a box.

    Parameters
    ----------
    material : name of its material
    center : [mm]
    size : edge lengths [mm]
    rotation : about x, then y, then z [degree]

    Returns
    -------
    the object
    """
    found = {"type": "box", "material": material, "center": _numbers(center), "size": _numbers(size)}
    return found | ({"rotation": _numbers(rotation)} if any(rotation) else {})


def ring(
    material: str, center: Point, radii: Point, tube: float, rotation: Point = (0, 0, 0), clip: Sequence[Object] = ()
) -> Object:
    """Create an elliptic ring around the z axis.

    Parameters
    ----------
    material : name of its material
    center : [mm]
    radii : half axes of the middle of its tube along x and y [mm]
    tube : radius of the tube where the ring is widest [mm]
    rotation : about x, then y, then z [degree]
    clip : planes that cut the ring, as a scene file has them

    Returns
    -------
    the object
    """
    wide = max(radii)
    found = {
        "type": "group",
        "center": _numbers(center),
        "scale": _numbers((*radii, wide)),
        "objects": [{"type": "torus", "material": material, "radius": 1.0, "tube": round(tube / wide, 6)}],
    }
    found |= {"rotation": _numbers(rotation)} if any(rotation) else {}
    return found | ({"clip": [*clip]} if clip else {})


def beyond(normal: Point, offset: float) -> Object:
    """Create a plane that cuts off all points with normal . x >= offset.

    Parameters
    ----------
    normal : of the plane
    offset : [mm] for a normal of length 1

    Returns
    -------
    the plane
    """
    return {"normal": _numbers(normal), "offset": round(offset, _DIGITS)}


def mirrored(item: Object) -> Object:
    """Mirror an object at the plane x = 0.

    Parameters
    ----------
    item : with centre, rotation and axis

    Returns
    -------
    its image
    """
    x, y, z = item["center"]
    image = {**item, "center": [-x, y, z]}
    if "rotation" in item:
        a, b, c = item["rotation"]
        image["rotation"] = [a, -b, -c]
    if "axis" in item:
        a, b, c = item["axis"]
        image["axis"] = [-a, b, c]
    return image


def both(item: Object) -> list[Object]:
    """Return an object and its mirror image.

    Parameters
    ----------
    item : see `mirrored`

    Returns
    -------
    both objects
    """
    return [item, mirrored(item)]
