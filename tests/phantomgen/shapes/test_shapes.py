"""Shapes: closed-form volumes, membership, bounds, and one sentence per bad value."""

from math import pi

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.path import Path

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
    rotation_matrix,
    solids_of,
)
from spectra.errors import InputError

SHAPES: list[Shape] = [
    Sphere((1.0, -2.0, 3.0), 2.5),
    Ellipsoid((1.0, 0.0, -1.0), (1.0, 2.0, 3.0), (0.3, -0.4, 1.2)),
    Cylinder((0.5, 0.0, 0.0), 1.5, 4.0),
    Cylinder((0.0, 1.0, 0.0), (1.0, 2.0), 3.0, (1.0, 2.0, -3.0)),
    Box((0.0, 0.0, 1.0), (2.0, 3.0, 4.0), (0.1, 0.2, 0.3)),
    Tube((0.5, 0.0, 0.0), 1.5, 1.0, 3.0, (1.0, 0.0, 1.0)),
    Capsule((0.0, 1.0, 0.0), 0.8, 2.0, (1.0, -1.0, 0.5)),
    Cone((0.0, 0.0, 1.0), (1.5, 0.0), 3.0, (0.0, 1.0, 1.0)),
    Cone((0.0, 0.5, 0.0), (1.0, 2.0), 2.0, (-1.0, 0.2, 0.3)),
    Torus((1.0, 0.0, 0.0), 1.5, 0.6, (0.3, 0.2, 1.0)),
    Polygon(((0.0, 0.0), (3.0, 0.0), (3.0, 2.0), (1.0, 0.8), (0.0, 2.0)), 1.5, (0.2, 0.1, 0.0)),
]
unit = st.floats(-1, 1)


@pytest.mark.parametrize("shape", SHAPES, ids=repr)
def test_monte_carlo_volume_and_bounds(shape: Shape) -> None:
    low, high = shape.bounds
    rng = np.random.default_rng(1)
    points = rng.uniform(low - 0.2, high + 0.2, (200_000, 3))
    inside = shape.contains(points)
    assert inside.mean() * np.prod(high - low + 0.4) == pytest.approx(shape.volume, rel=0.02)
    assert (points[inside] >= low).all()
    assert (points[inside] <= high).all()
    np.testing.assert_allclose(points[inside].min(axis=0), low, atol=0.15)


def test_closed_form_volumes() -> None:
    assert Sphere((0, 0, 0), 3.0).volume == pytest.approx(36 * pi)
    assert Cylinder((0, 0, 0), (2.0, 3.0), 5.0, (1, 1, 1)).volume == pytest.approx(30 * pi)
    assert Box((0, 0, 0), (2.0, 3.0, 4.0), (1, 2, 3)).volume == pytest.approx(24)


@given(axis=st.tuples(unit, unit, unit).filter(lambda a: np.linalg.norm(a) > 1e-6), point=st.tuples(unit, unit, unit))
def test_cylinder_is_where_its_distance_says(axis: tuple, point: tuple) -> None:
    cylinder = Cylinder((0.1, 0.2, 0.3), 0.5, 1.0, axis)
    direction = np.array(axis) / np.linalg.norm(axis)
    offset = np.array(point) - cylinder.center
    along = offset @ direction
    across = np.linalg.norm(offset - along * direction)
    if abs(across - 0.5) > 1e-9 and abs(abs(along) - 0.5) > 1e-9:
        assert cylinder.contains(np.array([point]))[0] == (across < 0.5 and abs(along) < 0.5)


@pytest.mark.parametrize("axis", [(0, 0, 1), (0, 0, -2), (1e-9, 0, -1), (0, -1e-170, -1), (1, 0, 0), (-3, 4, 1e-12)])
def test_axes_are_orthogonal_and_right_handed(axis: tuple) -> None:
    axes = Cylinder((0, 0, 0), 1.0, 2.0, axis).axes
    np.testing.assert_allclose(axes.T @ axes, np.eye(3), atol=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1)
    np.testing.assert_allclose(axes[:, 2], np.array(axis) / np.linalg.norm(axis), atol=1e-12)


def test_rotation_is_about_fixed_x_then_y_then_z() -> None:
    quarter = pi / 2
    np.testing.assert_allclose(rotation_matrix((quarter, 0, 0)) @ [0, 1, 0], [0, 0, 1], atol=1e-15)
    np.testing.assert_allclose(rotation_matrix((quarter, quarter, 0)) @ [0, 1, 0], [1, 0, 0], atol=1e-15)
    np.testing.assert_allclose(rotation_matrix((quarter, quarter, quarter)) @ [0, 1, 0], [0, 1, 0], atol=1e-15)


@settings(max_examples=50)
@given(point=st.tuples(unit, unit, unit))
def test_ellipsoid_with_equal_radii_is_a_sphere(point: tuple) -> None:
    points = np.array([point])
    sphere, ellipsoid = Sphere((0.1, 0, 0), 0.7), Ellipsoid((0.1, 0, 0), (0.7, 0.7, 0.7), (1, 2, 3))
    if abs(np.linalg.norm(points - sphere.center) - 0.7) > 1e-9:
        assert sphere.contains(points) == ellipsoid.contains(points)


def test_touching_boxes_share_no_point() -> None:
    left, right = Box((-1, 0, 0), (2, 2, 2)), Box((1, 0, 0), (2, 2, 2))
    face = np.array([[0.0, 0.3, 0.1]])
    assert left.contains(face)[0] != right.contains(face)[0]


def test_equality_and_repr() -> None:
    shape = Cylinder((0, 0, 0), 1.0, 2.0)
    assert shape == Cylinder((0.0, 0.0, 0.0), 1.0, 2.0)
    assert eval(repr(shape)) == shape


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Sphere((0, 0, 0), -1.0), "sphere radius must be positive"),
        (lambda: Sphere((0, 0), 1.0), "sphere center must be three finite numbers"),
        (lambda: Ellipsoid((0, 0, 0), (1.0, 0.0, 1.0)), "ellipsoid radii must be positive"),
        (lambda: Cylinder((0, 0, 0), (1.0, 2.0, 3.0), 1.0), "one number or two"),
        (lambda: Cylinder((0, 0, 0), 1.0, float("nan")), "cylinder length"),
        (lambda: Cylinder((0, 0, 0), 1.0, 1.0, (0, 0, 0)), "must not be the zero vector"),
        (lambda: Box((0, 0, float("inf")), (1, 1, 1)), "box center"),
        (lambda: Tube((0, 0, 0), 1.0, 1.0, 2.0), "inner_radius 1 must be smaller"),
        (lambda: Capsule((0, 0, 0), -1.0, 2.0), "capsule radius"),
        (lambda: Cone((0, 0, 0), (1.0, 1.0), 2.0), "take a cylinder"),
        (lambda: Cone((0, 0, 0), (0.0, 0.0), 2.0), "cone radii"),
        (lambda: Cone((0, 0, 0), (-1.0, 2.0), 2.0), "must not be negative"),
        (lambda: Torus((0, 0, 0), 1.0, 1.0), "smaller than its radius"),
        (lambda: Polygon(((0, 0), (1, 1), (3, 3.0)), 1.0), "lie on one line"),
        (lambda: Polygon(((0, 0), (1, 1)), 1.0), "at least three"),
        (lambda: Polygon(((0, 0), (1, 1), (1, 0), (0, 1)), 1.0), "edges 0 and 2 cross"),
        (lambda: HalfSpace((0, 0, 0), 1.0), "half-space normal"),
        (lambda: Placed(Sphere((0, 0, 0), 1.0), np.diag([1.0, 1.0, 0.0]), np.zeros(3)), "must not flatten"),
        (lambda: Intersection((Union((Sphere((0, 0, 0), 1.0),) * 30),) * 3).terms, "more than 500 pieces"),
        (lambda: solids_of([(Sphere((0, 0, 0), 1.0), -1)]), "must not be negative"),
    ],
)
@pytest.mark.wrong_types
def test_bad_values_are_one_sentence(make, words: str) -> None:
    with pytest.raises(InputError, match=words) as caught:
        make()
    assert "\n" not in str(caught.value)


def test_arrays_keep_order_and_materials() -> None:
    arrays = solids_of([(SHAPES[0], 2), (SHAPES[2], 0)])
    assert arrays.rows == 2
    assert arrays.materials.tolist() == [2, 0]
    surface = arrays.locals_[0][:, :3] @ np.array([1.0, -2.0, 5.5]) + arrays.locals_[0][:, 3]
    assert np.linalg.norm(surface) == pytest.approx(1)
    assert solids_of([]).rows == 0


CUTTERS = (Sphere((0.5, 0.2, 0.0), 1.2), Box((0.0, 1.0, 0.0), (1.0, 2.0, 5.0), (0.3, 0.0, 0.5)))
PIECE = HalfSpace((1.0, 2.0, 0.5), 0.4)


@pytest.mark.parametrize("shape", SHAPES, ids=repr)
def test_combinations_are_those_of_sets(shape: Shape) -> None:
    points = np.random.default_rng(2).uniform(-3, 3, (5000, 3))
    inside, (first, second) = shape.contains(points), (cutter.contains(points) for cutter in CUTTERS)
    below = PIECE.contains(points)
    for combined, expected in (
        (Difference(shape, CUTTERS), inside & ~first & ~second),
        (Intersection((shape, Union(CUTTERS), PIECE)), inside & (first | second) & below),
        (Difference(CUTTERS[1], (Difference(shape, (CUTTERS[0],)),)), second & ~(inside & ~first)),
    ):
        np.testing.assert_array_equal(combined.contains(points), expected)


def test_placed_shapes_go_where_their_points_go() -> None:
    matrix, offset = rotation_matrix((0.3, 0.2, 0.1)) @ np.diag([1.0, 2.0, 0.5]), np.array([1.0, 2.0, 3.0])
    points = np.random.default_rng(3).uniform(-3, 3, (2000, 3))
    for shape in SHAPES:
        placed = Placed(shape, matrix, offset)
        np.testing.assert_array_equal(placed.contains(points @ matrix.T + offset), shape.contains(points))
        assert placed.volume == pytest.approx(shape.volume)


@pytest.mark.parametrize("turn", [1, -1])
def test_polygon_is_where_its_outline_winds(turn: int) -> None:
    star = np.array([[np.cos(a), np.sin(a)] for a in np.arange(10) * np.pi / 5]) * np.tile([2.0, 0.7], 5)[:, None]
    prism = Polygon(tuple(map(tuple, star[::turn])), 2.0)
    points = np.random.default_rng(4).uniform(-2, 2, (5000, 3))
    assert (prism.contains(points) == (Path(star).contains_points(points[:, :2]) & (np.abs(points[:, 2]) < 1))).all()
    assert len(Polygon(((0, 0), (1, 0), (1, 1), (0, 1)), 1.0).terms) == 1
