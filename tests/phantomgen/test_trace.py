"""Path lengths: closed forms, sorted events, sums over materials, and invariances."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phantomgen.ops.trace import trace
from phantomgen.ops.trace.reference import trace_one
from phantomgen.shapes import Box, Cylinder, Ellipsoid, Shape, ShapeArrays, Sphere
from spectra.errors import InputError

OBJECTS: list[tuple[Shape, int]] = [
    (Cylinder((0, 0, 0), 50.0, 100.0), 0),
    (Cylinder((-22, 6, 0), 13.0, 80.0), 1),
    (Sphere((5, 5, 5), 20.0), 2),
    (Box((10, 0, 0), (30.0, 20.0, 10.0), (0.3, 0.2, 0.1)), 1),
    (Ellipsoid((0, 0, 20), (10.0, 20.0, 30.0), (1, 2, 3)), 0),
    (Cylinder((0, 10, 0), (5.0, 9.0), 70.0, (1, 1, 1)), 3),
]
number = st.floats(-60, 60)
point = st.tuples(number, number, number)


def lengths_of(objects: list[tuple[Shape, int]], origin: tuple, end: tuple, count: int = 1, background: int = -1):
    arrays = ShapeArrays.of(objects)
    origins = np.array([origin], dtype=np.float64)
    directions = np.array([end], dtype=np.float64) - origins
    return trace(origins, directions, arrays.kinds, arrays.locals_, arrays.materials, count, background)[0]


@pytest.mark.parametrize("background", [-1, 4])
def test_agrees_with_sorted_events(background: int) -> None:
    rng = np.random.default_rng(2)
    origins, directions = rng.normal(size=(300, 3)) * 60, rng.normal(size=(300, 3)) * 200
    arrays = ShapeArrays.of(OBJECTS)
    solids = (arrays.kinds, arrays.locals_, arrays.materials)
    found = trace(origins, directions, *solids, 5, background)
    expected = [trace_one(o, d, *solids, 5, background) for o, d in zip(origins, directions, strict=True)]
    np.testing.assert_allclose(found, expected, atol=1e-10)


@settings(max_examples=50)
@given(origin=point, end=point)
def test_background_fills_the_ray(origin: tuple, end: tuple) -> None:
    lengths = lengths_of(OBJECTS, origin, end, 5, 4)
    assert lengths.sum() == pytest.approx(np.linalg.norm(np.subtract(end, origin)), abs=1e-9)
    assert lengths.min() > -1e-9


@settings(max_examples=50)
@given(origin=point, end=point)
def test_way_back_is_as_long(origin: tuple, end: tuple) -> None:
    there, back = lengths_of(OBJECTS, origin, end, 4), lengths_of(OBJECTS, end, origin, 4)
    np.testing.assert_allclose(there, back, atol=1e-8)


@settings(max_examples=50)
@given(offset=st.floats(0, 29.9))
def test_sphere_chord(offset: float) -> None:
    found = lengths_of([(Sphere((1, 2, 3), 30.0), 0)], (-500, 2 + offset, 3), (300, 2 + offset, 3))
    assert found[0] == pytest.approx(2 * np.sqrt(30.0**2 - offset**2), rel=1e-12)


def test_oblique_cylinder_chord() -> None:
    found = lengths_of([(Cylinder((0, 0, 0), 10.0, 100.0), 0)], (-100, 0, -30), (100, 0, 30))
    assert found[0] == pytest.approx(20 * np.hypot(200, 60) / 200)


def test_box_diagonal() -> None:
    assert lengths_of([(Box((0, 0, 0), (2, 2, 2)), 0)], (-5, -5, -5), (5, 5, 5))[0] == pytest.approx(2 * np.sqrt(3))


def test_later_shape_overrides() -> None:
    big, small = Sphere((0, 0, 0), 10.0), Sphere((0, 0, 0), 4.0)
    ends = ((-20, 0, 0), (20, 0, 0))
    np.testing.assert_allclose(lengths_of([(big, 0), (small, 1)], *ends, 2), [12, 8])
    np.testing.assert_allclose(lengths_of([(small, 1), (big, 0)], *ends, 2), [20, 0])


def test_nothing_to_meet() -> None:
    assert lengths_of([], (0, 0, 0), (1, 2, 2), 2, 1).tolist() == [0, 3]
    assert lengths_of([(Sphere((0, 0, 9), 1.0), 0)], (0, 0, 0), (1, 2, 2)).tolist() == [0]


def test_refuses_materials_out_of_range() -> None:
    with pytest.raises(InputError, match=r"0\.\.0"):
        lengths_of([(Sphere((0, 0, 0), 1.0), 1)], (0, 0, 0), (1, 0, 0), 1)
    with pytest.raises(InputError, match="background"):
        lengths_of([(Sphere((0, 0, 0), 1.0), 0)], (0, 0, 0), (1, 0, 0), 1, 3)
