"""Shapes: closed-form volumes, membership, bounds, and one sentence per bad value."""

from math import pi

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phantomgen.shapes import Box, Cylinder, Ellipsoid, Shape, ShapeArrays, Sphere, rotation_matrix
from spectra.errors import InputError

SHAPES: list[Shape] = [
    Sphere((1.0, -2.0, 3.0), 2.5),
    Ellipsoid((1.0, 0.0, -1.0), (1.0, 2.0, 3.0), (0.3, -0.4, 1.2)),
    Cylinder((0.5, 0.0, 0.0), 1.5, 4.0),
    Cylinder((0.0, 1.0, 0.0), (1.0, 2.0), 3.0, (1.0, 2.0, -3.0)),
    Box((0.0, 0.0, 1.0), (2.0, 3.0, 4.0), (0.1, 0.2, 0.3)),
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
        (lambda: ShapeArrays.of([(Sphere((0, 0, 0), 1.0), -1)]), "must not be negative"),
    ],
)
def test_bad_values_are_one_sentence(make, words: str) -> None:
    with pytest.raises(InputError, match=words) as caught:
        make()
    assert "\n" not in str(caught.value)


def test_arrays_keep_order_and_materials() -> None:
    arrays = ShapeArrays.of([(SHAPES[0], 2), (SHAPES[2], 0)])
    assert len(arrays) == 2
    assert arrays.materials.tolist() == [2, 0]
    surface = arrays.locals_[0][:, :3] @ np.array([1.0, -2.0, 5.5]) + arrays.locals_[0][:, 3]
    assert np.linalg.norm(surface) == pytest.approx(1)
    assert len(ShapeArrays.of([])) == 0
