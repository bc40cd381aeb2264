"""Rays at the limits: their paths against chords in closed form."""

from collections.abc import Iterator, Sequence
from fractions import Fraction
from math import sqrt

import numpy as np

from phantomgen.ops.trace import trace
from phantomgen.shapes import Box, Cylinder, Mesh, Shape, Sphere, Tube, solids_of
from phantomgen.stress.case import Point

_RADIUS = 10.0  # mm
_CUBE = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * _RADIUS
_FACES = np.array(
    [
        [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
        [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ]
)  # fmt: skip


def _path(shapes: Sequence[Shape], start: Sequence[float], end: Sequence[float]) -> np.ndarray:
    """Path length in each shape [mm]; later shapes override earlier ones."""
    objects = [(shape, number) for number, shape in enumerate(shapes)]
    origin = np.array([start], dtype=np.float64)
    return trace(origin, np.array([end], dtype=np.float64) - origin, solids_of(objects), len(objects))[0]


def _point(difficulty: float, found: float, expected: float, size: float = 2 * _RADIUS) -> Point:
    return Point(difficulty, float(found), float(expected), abs(float(found) - float(expected)) / size)


def _chord(radius: float, distance: float) -> float:
    """Chord of a ball at a distance from its centre, without cancellation."""
    half = max(Fraction(radius) ** 2 - Fraction(distance) ** 2, Fraction(0))
    return 2 * sqrt(half)


def grazing() -> Iterator[Point]:
    """Rays that touch a ball ever closer to its surface.

    Yields
    ------
    distance to the surface as a part of the radius
    """
    for exponent in range(1, 15):
        distance = _RADIUS * (1 - 10.0**-exponent)
        (found,) = _path([Sphere((0, 0, 0), _RADIUS)], (-500, distance, 0), (300, distance, 0))
        yield _point(10.0**-exponent, found, _chord(_RADIUS, distance))


def along_an_axis() -> Iterator[Point]:
    """Rays along a cylinder, ever closer to its curved wall from inside.

    Yields
    ------
    distance to the wall [mm]
    """
    for exponent in range(13):
        x = _RADIUS - 10.0**-exponent
        (found,) = _path([Cylinder((0, 0, 0), _RADIUS, 8.0)], (x, 0, -500), (x, 0, 300))
        yield _point(10.0**-exponent, found, 8.0)


def corners() -> Iterator[Point]:
    """Rays parallel to the diagonal of a cube of triangles, ever closer to its corners, and through them.

    Moved by d along (1, -1, 0) / sqrt(2), the chord is sqrt(3) (edge - sqrt(2) d).

    Yields
    ------
    distance to the corner [mm]
    """
    cube = Mesh(_CUBE, _FACES, name="cube")
    for distance in (*(10.0**-exponent for exponent in range(1, 14)), 0.0):
        step = np.array([1, -1, 0]) * distance / sqrt(2)
        (found,) = _path([cube], (step - 200.0).tolist(), (step + 100.0).tolist())
        yield _point(distance, found, sqrt(3) * (2 * _RADIUS - sqrt(2) * distance))


def edges() -> Iterator[Point]:
    """Rays through two opposite edges of a cube of triangles, ever closer to the middles of these.

    All chords are 2 sqrt(2) half edges.

    Yields
    ------
    distance to the middle [mm]
    """
    cube = Mesh(_CUBE, _FACES, name="cube")
    for distance in (*(10.0**-exponent for exponent in range(1, 14)), 0.0):
        (found,) = _path([cube], (-200, distance, -200), (100, distance, 100))
        yield _point(distance, found, 2 * sqrt(2) * _RADIUS)


def coincident() -> Iterator[Point]:
    """Boxes that share all faces: only the last one counts.

    Yields
    ------
    number of boxes
    """
    for count in (2, 3, 5, 10, 20):
        found = _path([Box((0, 0, 0), (20, 20, 20))] * count, (-50, 1, -7), (50, 1, -7))
        yield Point(count, float(found[-1]), 20.0, float(abs(found[-1] - 20) + np.abs(found[:-1]).max()) / 20)


def nested() -> Iterator[Point]:
    """Many balls, one within the other, so that each is a shell.

    Yields
    ------
    number of balls
    """
    for count in (2, 10, 100, 500):
        radii = _RADIUS * (1 - np.arange(count) / count)
        found = _path([Sphere((0, 0, 0), float(radius)) for radius in radii], (-500, 3e-3, 0), (300, 3e-3, 0))
        chords = np.array([*(_chord(float(radius), 3e-3) for radius in radii), 0.0])
        worst = int(np.argmax(np.abs(found - (chords[:-1] - chords[1:]))))
        yield _point(count, found[worst], chords[worst] - chords[worst + 1])


def thin_shells() -> Iterator[Point]:
    """Tubes whose wall is ever thinner, crossed twice through the axis.

    Yields
    ------
    thickness [mm]
    """
    for exponent in range(13):
        inner = _RADIUS - 10.0**-exponent
        (found,) = _path([Tube((0, 0, 0), _RADIUS, inner, 30.0)], (-500, 0, 1), (300, 0, 1))
        yield _point(10.0**-exponent, found, 2 * float(Fraction(_RADIUS) - Fraction(inner)))


def source_inside() -> Iterator[Point]:
    """A source inside a ball, ever closer to its surface, that looks outward.

    Yields
    ------
    depth of the source [mm]
    """
    for exponent in range(13):
        start = _RADIUS - 10.0**-exponent
        (found,) = _path([Sphere((0, 0, 0), _RADIUS)], (start, 0, 0), (800, 0, 0))
        yield _point(10.0**-exponent, found, float(Fraction(_RADIUS) - Fraction(start)))


def far_away() -> Iterator[Point]:
    """A ball ever further from the origin, seen from 500 mm.

    Yields
    ------
    distance from the origin [mm]
    """
    for exponent in range(8):
        at = 1.1 * 10.0**exponent
        (found,) = _path([Sphere((at, at, 0), _RADIUS)], (at - 500, at + 5.1, 0), (at + 300, at + 5.1, 0))
        yield _point(at, found, _chord(_RADIUS, (at + 5.1) - at))
