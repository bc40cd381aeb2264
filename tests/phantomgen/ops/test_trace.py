"""Path lengths: closed forms, sorted events, sums over materials, and invariances."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phantomgen.ops.trace import trace
from phantomgen.ops.trace.reference import trace_one
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
    solids_of,
)
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
    origins = np.array([origin], dtype=np.float64)
    directions = np.array([end], dtype=np.float64) - origins
    return trace(origins, directions, solids_of(objects), count, background)[0]


@pytest.mark.parametrize("background", [-1, 4])
def test_agrees_with_sorted_events(background: int) -> None:
    rng = np.random.default_rng(2)
    origins, directions = rng.normal(size=(300, 3)) * 60, rng.normal(size=(300, 3)) * 200
    solids = solids_of(OBJECTS)
    found = trace(origins, directions, solids, 5, background)
    expected = [trace_one(o, d, solids, 5, background) for o, d in zip(origins, directions, strict=True)]
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


SOLIDS: dict[str, Shape] = {
    "tube": Tube((3, 2, 1), 30.0, 20.0, 50.0, (1, 2, 3)),
    "capsule": Capsule((3, 2, 1), 20.0, 30.0, (3, -1, 1)),
    "cone": Cone((3, 2, 1), (0.0, 30.0), 50.0, (1, 0.2, 0.3)),
    "frustum": Cone((3, 2, 1), (30.0, 10.0), 50.0, (1, 0.2, -0.3)),
    "torus": Torus((3, 2, 1), 30.0, 12.0, (1, 0.2, 0.3)),
    "thin ring": Torus((3, 2, 1), 30.0, 0.01, (0, 0.2, 0.3)),
    "star": Polygon(((0, 30), (8, 8), (30, 0), (8, -8), (0, -30), (-8, -8), (-30, 0), (-8, 8)), 40.0, (3, 2, 1)),
    "difference": Difference(Sphere((0, 0, 0), 30.0), (Torus((0, 0, 5), 25.0, 10.0), Box((0, 0, 0), (80, 10, 10)))),
    "wedge": Intersection((Cylinder((0, 0, 0), 30.0, 20.0), HalfSpace((1, 0, 0), 5.0), HalfSpace((-1, 2, 0), 5.0))),
    "squeezed torus": Placed(Torus((0, 0, 0), 30.0, 12.0), np.diag([1.0, 0.5, 1.5]), np.array([1.0, 2.0, 3.0])),
}


@pytest.mark.parametrize("name", SOLIDS)
def test_solids_agree_with_sorted_events(name: str) -> None:
    rng = np.random.default_rng(3)
    origins, ends = rng.normal(size=(2, 300, 3)) * 60
    origins[:20], ends[:20, 2] = 0.0, 0.0  # from inside, and in planes of symmetry
    solids = solids_of([(Sphere((0, 5, 0), 35.0), 0), (SOLIDS[name], 1)])
    found = trace(origins, ends - origins, solids, 2)
    expected = [trace_one(o, d, solids, 2) for o, d in zip(origins, ends - origins, strict=True)]
    np.testing.assert_allclose(found, expected, atol=2e-6 if name == "thin ring" else 2e-8)  # that of polynomial roots


def test_torus_chords() -> None:
    ring = [(Torus((0, 0, 0), 30.0, 12.0), 0)]
    assert lengths_of(ring, (-100, 0, 0), (100, 0, 0))[0] == pytest.approx(48, rel=1e-12)
    assert lengths_of(ring, (0, 0, -100), (0, 0, 100))[0] == 0
    assert lengths_of(ring, (30, 0, -100), (30, 0, 100))[0] == pytest.approx(24, rel=1e-12)
    assert lengths_of(ring, (-100, 0, 12), (100, 0, 12))[0] == pytest.approx(0, abs=1e-5)  # grazes the top
    assert lengths_of(ring, (-100, 30, 0), (100, 30, 0))[0] == pytest.approx(2 * np.sqrt(42**2 - 30**2), rel=1e-12)
    assert lengths_of(ring, (30, 0, 0), (100, 0, 0))[0] == pytest.approx(12, rel=1e-12)


@settings(max_examples=50)
@given(beside=st.floats(0.0, 41.9))
def test_chords_in_the_plane_of_a_ring_end_on_its_equator(beside: float) -> None:
    found = lengths_of([(Torus((0, 0, 0), 30.0, 12.0), 0)], (-100, beside, 0), (100, beside, 0))[0]
    hole = np.sqrt(18**2 - beside**2) if beside < 18 else 0.0
    assert found == pytest.approx(2 * (np.sqrt(42**2 - beside**2) - hole), rel=1e-12)


@settings(max_examples=50)
@given(height=st.floats(0.01, 49.9), slope=st.floats(-0.4, 0.4))
def test_cone_chord(height: float, slope: float) -> None:
    # Across the axis in the plane y = 0: the mantle x = +-z 30 / 50 cuts the line z = height + slope x.
    found = lengths_of(
        [(Cone((0, 0, 25), (0.0, 30.0), 50.0), 0)], (-100, 0, height - 100 * slope), (100, 0, height + 100 * slope)
    )
    left, right = -0.6 * height / (1 + 0.6 * slope), 0.6 * height / (1 - 0.6 * slope)
    if slope:  # the base z = 50 may cut the chord
        top = (50 - height) / slope
        left, right = (left, min(right, top)) if slope > 0 else (max(left, top), right)
    assert found[0] == pytest.approx(max(right - left, 0) * np.hypot(1, slope), rel=1e-9, abs=1e-9)


def test_nothing_to_meet() -> None:
    assert lengths_of([], (0, 0, 0), (1, 2, 2), 2, 1).tolist() == [0, 3]
    assert lengths_of([(Sphere((0, 0, 9), 1.0), 0)], (0, 0, 0), (1, 2, 2)).tolist() == [0]


def test_refuses_materials_out_of_range() -> None:
    with pytest.raises(InputError, match=r"0\.\.0"):
        lengths_of([(Sphere((0, 0, 0), 1.0), 1)], (0, 0, 0), (1, 0, 0), 1)
    with pytest.raises(InputError, match="background"):
        lengths_of([(Sphere((0, 0, 0), 1.0), 0)], (0, 0, 0), (1, 0, 0), 1, 3)
