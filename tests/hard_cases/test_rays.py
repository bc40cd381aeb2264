"""Rays that graze, run along an axis or in a face, begin or end inside, and shapes that share surfaces."""

from fractions import Fraction

import numpy as np
import pytest

from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.ops.expected_counts import CROSSED, INTERSECTED, Spectrum, expected_counts, expected_counts_by_grid
from phantomgen.ops.trace import trace
from phantomgen.ops.voxelize_shapes import fractions
from phantomgen.shapes import (
    Box,
    Capsule,
    Cone,
    Cylinder,
    Ellipsoid,
    Intersection,
    Shape,
    Sphere,
    Torus,
    Tube,
    solids_of,
)

ATTENUATION = np.array([[0.05, 0.02], [0.2, 0.1]])
WEIGHTS = np.array([1.0, 2.0])
SPECTRUM = Spectrum(ATTENUATION, WEIGHTS, np.array([0, 1, 2]))


def path(objects: list[tuple[Shape, int]], origin: tuple, end: tuple) -> list[float]:
    arrays = solids_of(objects)
    direction = np.subtract(end, origin, dtype=np.float64)[None]
    lengths = trace(np.array([origin], float), direction, arrays, 2)
    return lengths[0].tolist()


def exposed(objects: list[tuple[Shape, int]], rows: int = 24, pitch: float = 4.0, rays: int = 128):
    """One view of objects, and the same by rays x rays through each pixel."""
    solids = solids_of(objects)
    frame = Geometry.circular(500.0, 800.0, np.array([0.3]), Panel(rows, rows, pitch)).ray_frames()[0]
    found = expected_counts(frame, rows, rows, solids, SPECTRUM)
    pixels = np.argwhere(np.ones((rows, rows)))
    brute = expected_counts_by_grid(frame, pixels, solids, SPECTRUM, n=rays)
    return found, np.abs(np.log(found.counts.reshape(2, -1).T / brute)).max(axis=1).reshape(rows, rows)


def test_tangent_ray_has_no_length_and_its_neighbour_inside_has_one() -> None:
    for shape in (Sphere((0, 0, 0), 10.0), Cylinder((0, 0, 0), 10.0, 8.0)):
        assert path([(shape, 0)], (-50, 10, 0), (50, 10, 0))[0] == 0
        assert path([(shape, 0)], (-50, 10 * (1 - 1e-12), 0), (50, 10 * (1 - 1e-12), 0))[0] == pytest.approx(
            20 * np.sqrt(2e-12), rel=1e-3
        )


def rational_chord(shape: Shape, signs: tuple[int, int, int], level: int, origin, direction) -> float:
    """Chord where ``sum(sign x^2) < level`` in local coordinates of the only primitive, without rounding."""
    ((part,),) = shape.terms
    rows = [[Fraction(number) for number in row] for row in part.local.tolist()]
    start, along = ([Fraction(number) for number in vector.tolist()] for vector in (origin, direction))
    o = [sum((m * x for m, x in zip(row, start, strict=False)), row[3]) for row in rows]
    d = [sum((m * x for m, x in zip(row, along, strict=False)), Fraction(0)) for row in rows]
    a, b, c = (sum(s * x * y for s, x, y in zip(signs, *pair, strict=True)) for pair in ((d, d), (o, d), (o, o)))
    discriminant = float(b * b - a * (c - level))
    return 2 * np.sqrt(max(discriminant, 0.0)) / float(a) * float(np.linalg.norm(direction))


@pytest.mark.parametrize(
    ("shape", "signs", "level"),
    [
        (Ellipsoid((1, 2, 3), (10.0, 20.0, 30.0), (0.3, 0.5, 0.7)), (1, 1, 1), 1),
        (Cylinder((1, 2, 3), (20.0, 10.0), 1e4, (1, 2, 3)), (1, 1, 0), 1),
        (Cone((1, 2, 3), (0.0, 20.0), 50.0, (1, 2, 3)), (1, 1, -1), 0),
    ],
)
@pytest.mark.parametrize("distance", [200.0, 2e4])
def test_grazing_chords_against_rational_arithmetic(shape, signs, level, distance) -> None:
    """Rays are moved sideways until chords are some 1e-4 to 1e-9 of the shape."""
    rng = np.random.default_rng(1)
    middle = np.array([1.0, 2, 3])
    axis = np.array([1.0, 2, 3]) / np.sqrt(14)
    side = np.cross(rng.normal(size=(300, 3)), axis)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    direction = 2 * distance * (np.cross(side, axis) + 0.1 * rng.normal(size=(300, 1)) * axis)
    solids, near, far = solids_of([(shape, 0)]), np.zeros(300), np.full(300, 100.0)
    steps = rng.integers(25, 60, 300)
    for step in range(60):
        between = (near + far) / 2
        start = middle + between[:, None] * side - direction / 2
        hit = trace(start, direction, solids, 1)[:, 0] > 0
        near = np.where(hit & (step < steps), between, near)
        far = np.where(~hit & (step < steps), between, far)
    origin = middle + near[:, None] * side - direction / 2
    found = trace(origin, direction, solids, 1)[:, 0]
    exact = [rational_chord(shape, signs, level, o, d) for o, d in zip(origin, direction, strict=True)]
    assert np.sort(found)[30] < 1e-3
    np.testing.assert_allclose(found, exact, rtol=0, atol=1e-10)


@pytest.mark.parametrize(("x", "length"), [(0.0, 8.0), (9.999999999, 8.0), (10.000000001, 0.0)])
def test_ray_along_the_axis_of_a_cylinder(x: float, length: float) -> None:
    assert path([(Cylinder((0, 0, 0), 10.0, 8.0), 0)], (x, 0, -50), (x, 0, 50))[0] == pytest.approx(length)


def test_ray_almost_along_the_axis() -> None:
    found = path([(Cylinder((0, 0, 0), 10.0, 8.0), 0)], (0, 0, -50), (1e-9, 1e-200, 50))
    assert found[0] == pytest.approx(8)


def test_ray_in_a_shared_face_belongs_to_one_box() -> None:
    boxes = [(Box((-1, 0, 0), (2, 2, 2)), 0), (Box((1, 0, 0), (2, 2, 2)), 1)]
    assert path(boxes, (0, -5, 0), (0, 5, 0)) == pytest.approx([0, 2])


def test_source_and_panel_inside() -> None:
    ball = [(Sphere((0, 0, 0), 10.0), 0)]
    assert path(ball, (0, 0, 0), (50, 0, 0))[0] == pytest.approx(10)
    assert path(ball, (-50, 0, 0), (4, 0, 0))[0] == pytest.approx(14)
    assert path(ball, (-3, 0, 0), (4, 0, 0))[0] == pytest.approx(7)
    assert path(ball, (11, 0, 0), (50, 0, 0))[0] == 0


def test_coincident_surfaces_leave_no_trace_of_the_lower_shape() -> None:
    cylinder, box = Cylinder((0, 0, 0), 5.0, 8.0), Box((0, 0, 0), (4, 4, 4))
    for shape in (cylinder, box, Sphere((0, 0, 0), 3.0)):
        lower, upper = path([(shape, 0), (shape, 1)], (-50, 1, -7), (50, 1.5, 9))
        assert lower == 0
        assert upper > 0
    inner = Cylinder((1, 0, 0), 2.0, 8.0)
    lengths = path([(cylinder, 0), (inner, 1)], (1, 0, -50), (1, 0.5, 50))
    assert lengths[0] == pytest.approx(0, abs=1e-12)


CASES: dict[str, tuple[list[tuple[Shape, int]], float, float]] = {
    # name: objects, largest error of a log-projection in crossed pixels (that of the many rays, mostly), elsewhere
    "cap in the plane of the source": ([(Cylinder((0, 0, 15), 20.0, 30.0), 0)], 3e-3, 1e-3),
    "cap just off that plane": ([(Cylinder((0, 0, 15 + 1e-8), 20.0, 30.0), 0)], 3e-3, 1e-3),
    "face in the plane of the source": ([(Box((0, 0, 10), (30, 30, 20)), 0)], 3e-3, 1e-3),
    "source inside a ball": ([(Sphere((480, 150, 0), 100.0), 0)], 1e-9, 1e-9),
    "panel inside a ball": ([(Sphere((-286.6, -88.7, 0), 300.0), 0)], 3e-3, 1e-3),
    "smaller than a pixel": ([(Sphere((1, 2, 3), 0.3), 1)], 1e-4, 1e-9),
    "needle": ([(Cylinder((1, 2, 3), 0.05, 60.0, (1, 2, 1)), 1)], 1e-4, 1e-9),
    "thin shell": ([(Sphere((1, 2, 3), 15.0), 1), (Sphere((1, 2, 3), 14.95), 0)], 2e-3, 1e-3),
    "same shape twice": ([(Box((1, 2, 3), (20, 20, 20), (1, 2, 3)), 0)] * 2, 2e-3, 1e-3),
    "tilted cylinder": ([(Cylinder((0, 0, 0), 15.0, 20.0, (1, 1, 1)), 0)], 2e-3, 1e-3),
    "ellipsoid": ([(Ellipsoid((0, 0, 0), (5.0, 15.0, 20.0), (1, 2, 3)), 0)], 2e-3, 1e-3),
    "tube": ([(Tube((0, 0, 0), 15.0, 10.0, 20.0, (1, 1, 1)), 0)], 2e-3, 1e-3),
    "capsule": ([(Capsule((0, 0, 0), 8.0, 20.0, (1, 0.5, 1)), 0)], 2e-3, 1e-3),
    "cone": ([(Cone((0, 0, 0), (0.0, 15.0), 30.0, (1, 0.2, 0.5)), 0)], 2e-3, 1e-3),
    "frustum": ([(Cone((0, 0, 0), (15.0, 5.0), 30.0, (1, 0.2, 0.5)), 0)], 2e-3, 1e-3),
    "torus": ([(Torus((0, 0, 0), 15.0, 5.0, (1, 0.2, 0.5)), 0)], 2e-2, 1e-2),
    "lens": ([(Intersection((Sphere((0, 0, 9), 15.0), Sphere((0, 0, -9), 15.0))), 0)], 2e-2, 1e-2),
    "shapes that intersect": ([(Sphere((0, 0, 0), 12.0), 0), (Sphere((8, 8, 2), 10.0), 1)], 2e-2, 1e-2),
}


@pytest.mark.parametrize("name", CASES)
@pytest.mark.slow
def test_pixels_agree_with_many_rays(name: str) -> None:
    objects, crossed, elsewhere = CASES[name]
    found, error = exposed(objects, rays=128 if crossed < 1e-2 else 48)
    assert error[found.classes >= CROSSED].max(initial=0) < crossed
    assert error[found.classes < CROSSED].max(initial=0) < elsewhere


def test_intersecting_surfaces_are_noticed() -> None:
    found, error = exposed(CASES["shapes that intersect"][0], 60, 1.0, rays=64)
    assert (found.classes == INTERSECTED).any()
    assert error[found.classes == INTERSECTED].max() < 2e-3


def test_one_pixel_and_no_object() -> None:
    solids = solids_of([(Sphere((0, 0, 0), 5.0), 0)])
    frame = Geometry.circular(500.0, 800.0, np.zeros(1), Panel(1, 1, 40.0)).ray_frames()[0]
    counts = expected_counts(frame, 1, 1, solids, SPECTRUM).counts[:, 0, 0]
    np.testing.assert_allclose(
        counts,
        expected_counts_by_grid(frame, np.zeros((1, 2), int), solids, SPECTRUM, n=512)[0],
        rtol=1e-4,
    )
    empty = solids_of([])
    found = expected_counts(frame, 1, 1, empty, SPECTRUM)
    assert found.counts[:, 0, 0].tolist() == [1, 2]
    assert found.rays.sum() == 0


def test_one_voxel() -> None:
    arrays = solids_of([(Sphere((0.1, 0, 0), 0.4), 0), (Box((0, 0, 0.3), (0.1, 0.1, 0.1)), 1)])
    found = fractions(Grid.cube(1, 1.0), arrays, 2)
    inside = 4 / 3 * np.pi * 0.4**3 - found[1, 0, 0, 0]
    assert found[1, 0, 0, 0] == pytest.approx(1e-3, rel=1e-5)
    assert found[0, 0, 0, 0] == pytest.approx(inside, rel=1e-3)
