"""Round tubes along a curve, of changing width: vessels, ribs, wires."""

from collections.abc import Sequence
from math import pi, sin, sqrt

import numpy as np
from jaxtyping import Float, Int64

from phantomgen.shapes.base import checked_lengths
from phantomgen.shapes.meshes.mesh import Mesh
from spectra.errors import InputError

Points = Float[np.ndarray, "point 3"]


def sweep(
    points: Sequence[Sequence[float]] | Points, radius: float | Sequence[float], sides: int = 24, steps: int = 8
) -> Mesh:
    """Create a closed mesh of rings around a smooth curve, with flat ends.

    Parameters
    ----------
    points : where the curve passes (x, y, z) [mm]
    radius : one radius, or one per point [mm]; from point to point it changes as smoothly as the curve
    sides : corners of a ring, whose area is that of its circle
    steps : rings from one point to the next

    Returns
    -------
    the mesh

    Raises
    ------
    InputError
        When the tube would turn over: its bends must be wider than its radius.

    Notes
    -----
    The curve is a centripetal Catmull-Rom spline, which has no cusps between points (Yuksel, Schaefer, Keyser 2011,
    doi:10.1016/j.cad.2010.08.008). Rings turn as little as possible from one to the next (rotation-minimising frames by
    double reflection: Wang, Juettler, Zheng, Liu 2008, doi:10.1145/1330511.1330513).
    """
    through = np.asarray(points, dtype=np.float64)
    if through.ndim != 2 or through.shape[1] != 3 or len(through) < 2 or not np.isfinite(through).all():
        raise InputError(f"sweep points must be at least two finite triples, got {points!r}")
    if (through[1:] == through[:-1]).all(axis=1).any():
        raise InputError("sweep points must differ from their neighbours")
    radii = np.asarray(radius, dtype=np.float64)
    if radii.shape not in ((), (len(through),)):
        raise InputError(f"sweep radius must be one number, or one for each of {len(through)} points, got {radius!r}")
    if sides < 3 or steps < 1:
        raise InputError(f"a sweep needs at least 3 sides and 1 step, got {sides} and {steps}")
    curve = _spline(np.column_stack([through, np.broadcast_to(radii, len(through))]), steps)
    checked_lengths("sweep", "radius", tuple(curve[:, 3].tolist()))
    try:
        return Mesh(_rings(curve[:, :3], curve[:, 3], sides), _skin(len(curve), sides), name="sweep")
    except InputError:
        raise InputError("the sweep crosses itself: its bends must be wider than its radius") from None


def _spline(knots: Float[np.ndarray, "point 4"], steps: int) -> Float[np.ndarray, "ring 4"]:
    """Points of a Catmull-Rom spline, whose parameter runs with the root of the distance between points."""
    gaps = np.sqrt(np.linalg.norm(np.diff(knots[:, :3], axis=0), axis=1))[:, None]
    slopes = np.diff(knots, axis=0) / gaps
    across = (knots[2:] - knots[:-2]) / (gaps[1:] + gaps[:-1])
    tangents = np.concatenate([slopes[:1], slopes[:-1] - across + slopes[1:], slopes[-1:]])
    u = (np.arange(steps) / steps)[:, None, None]
    pieces = (
        (1 + 2 * u) * (1 - u) ** 2 * knots[:-1]
        + u * (1 - u) ** 2 * gaps * tangents[:-1]
        + u**2 * (3 - 2 * u) * knots[1:]
        - u**2 * (1 - u) * gaps * tangents[1:]
    )
    return np.concatenate([pieces.transpose(1, 0, 2).reshape(-1, 4), knots[-1:]])


def _rings(curve: Points, radii: Float[np.ndarray, " ring"], sides: int) -> Float[np.ndarray, "corner 3"]:
    """Corners of all rings, ring by ring, and then the middles of both ends."""
    along = np.gradient(curve, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    side = np.cross(along[0], np.eye(3)[np.argmin(np.abs(along[0]))])
    sides_of = [side / np.linalg.norm(side)]
    for i in range(len(curve) - 1):
        sides_of.append(_carried(sides_of[-1], curve[i + 1] - curve[i], along[i], along[i + 1]))
    first = np.array(sides_of)
    second = np.cross(along, first)
    turn = 2 * pi * np.arange(sides)[:, None] / sides
    circle = np.cos(turn) * first[:, None] + np.sin(turn) * second[:, None]
    widened = radii * sqrt(2 * pi / (sides * sin(2 * pi / sides)))
    return np.concatenate([(curve[:, None] + widened[:, None, None] * circle).reshape(-1, 3), curve[[0, -1]]])


def _carried(side: np.ndarray, step: np.ndarray, before: np.ndarray, behind: np.ndarray) -> np.ndarray:
    """The direction `side` one ring further: reflected at the plane between the rings, then at that of the tangents."""
    once = side - 2 * (step @ side) / (step @ step) * step
    mirrored = before - 2 * (step @ before) / (step @ step) * step
    twist = behind - mirrored
    return once - 2 * (twist @ once) / (twist @ twist) * twist if twist @ twist > 0 else once


def _skin(rings: int, sides: int) -> Int64[np.ndarray, "triangle 3"]:
    """Triangles between neighbouring rings and over both ends, counter-clockwise seen from outside."""
    here = np.arange(sides)
    there = np.roll(here, -1)
    quads = [(here, there, here + sides), (there, there + sides, here + sides)]
    between = [np.stack(quad, axis=1) + sides * ring for ring in range(rings - 1) for quad in quads]
    low, high = rings * sides, rings * sides + 1
    last = sides * (rings - 1)
    ends = [
        np.stack([there, here, np.full(sides, low)], 1),
        np.stack([here + last, there + last, np.full(sides, high)], 1),
    ]
    return np.concatenate([*between, *ends])
