"""Orbits and mounted panels against closed forms, and the laws that geometries keep."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phantomgen.geometry.orbits import between, deflected, helical, laminography, parallel, short_arc, spread_angles
from phantomgen.geometry.panel import Panel
from phantomgen.geometry.panel_mount import Mount, mounted
from phantomgen.geometry.poses import FAR, Geometry
from phantomgen.ops.trace import trace
from phantomgen.shapes import Box, Cylinder, Ellipsoid, Sphere, rotation_matrix, solids_of
from spectra.errors import GeometryError

PANEL = Panel(5, 7, (2.0, 3.0))
ANGLES = np.deg2rad([0.0, 40.0, 200.0, 355.0])
angle = st.floats(-3.0, 3.0)
small = st.floats(-0.5, 0.5)


def rays(geometry: Geometry) -> tuple[np.ndarray, np.ndarray]:
    """Start and direction of all rays through pixel centres, view by view."""
    frames, panel = geometry.ray_frames(), geometry.panel
    rows, columns = np.mgrid[: panel.rows, : panel.columns]
    steps = columns[..., None] * frames[:, None, None, 2] + rows[..., None] * frames[:, None, None, 3]
    directions = frames[:, None, None, 1] + steps
    return np.broadcast_to(frames[:, None, None, 0], directions.shape).reshape(-1, 3), directions.reshape(-1, 3)


def chords(geometry: Geometry, *shapes) -> np.ndarray:
    solids = solids_of(tuple((shape, 0) for shape in shapes))
    return trace(*rays(geometry), solids, 1).reshape(len(geometry), geometry.panel.rows, geometry.panel.columns)


def test_views_are_spread_over_the_arc_without_its_end():
    degrees = np.rad2deg(spread_angles(4, 2, 200.0, 30.0))
    np.testing.assert_allclose(degrees, [30, 80, 130, 180, 80, 180])
    np.testing.assert_array_equal(spread_angles(75, 100, 360.0), spread_angles(75, 100))


def test_test_views_stand_in_the_gaps_of_a_list():
    np.testing.assert_array_equal(between(np.array([0.0, 2.0, 10.0, 11.0]), 3), [1.0, 6.0, 10.5])
    np.testing.assert_array_equal(between(np.array([0.0, 2.0, 10.0, 11.0]), 1), [6.0])
    with pytest.raises(GeometryError, match="4 test views do not fit between 4 angles: at most 3 do"):
        between(np.arange(4.0), 4)


def test_a_short_scan_is_half_a_turn_and_the_fan():
    assert short_arc(np.deg2rad(7.5)) == pytest.approx(195.0)
    assert short_arc(np.deg2rad(120.0)) == 360.0


def test_a_helix_without_pitch_is_a_circle_and_rises_by_its_pitch_per_turn():
    circle = Geometry.circular(500, 800, ANGLES, PANEL)
    assert helical(500, 800, ANGLES, 0.0, PANEL) == circle
    helix = helical(500, 800, ANGLES + 2 * np.pi, -12.0, PANEL, z=5.0)
    np.testing.assert_allclose(helix.source[:, 2], 5.0 - 12.0 * (1 + np.rad2deg(ANGLES) / 360))
    np.testing.assert_allclose(helix.panel_center - helix.source, circle.panel_center - circle.source, atol=1e-9)


def test_a_deflected_focal_spot_moves_alone():
    """Against the closed form: by hand for a source on the x axis, and by a rotation for the others."""
    geometry = helical(500, 800, ANGLES, -12.0, PANEL, z=5.0)
    deflections = np.array([[0.5, 0.0, 0.0], [0.0, 0.25, 0.0], [0.0, 0.0, 2.0], [0.5, 0.25, 2.0]])
    moved = deflected(geometry, deflections)
    c, s = np.cos(ANGLES), np.sin(ANGLES)
    along, _, outward = deflections.T
    x, y = (500 + outward) * c - along * s, (500 + outward) * s + along * c
    expected = np.stack([x, y, geometry.source[:, 2] + deflections[:, 1]], axis=1)
    np.testing.assert_allclose(moved.source, expected, rtol=1e-13)
    np.testing.assert_array_equal(moved.panel_center, geometry.panel_center)
    np.testing.assert_array_equal(moved.column_step, geometry.column_step)
    np.testing.assert_array_equal(moved.angles, geometry.angles)
    with pytest.raises(GeometryError, match="500 mm from its nominal position: it must be less than 500 mm"):
        deflected(geometry, np.array([[0.0, 0.0, -500.0]] * 4))


def test_laminography_leans_the_axis_by_its_tilt():
    tilt = np.deg2rad(30)
    geometry = laminography(500, 800, ANGLES, tilt, PANEL)
    beam = (geometry.panel_center - geometry.source) / 800
    np.testing.assert_allclose(beam @ [0, 0, 1], -np.sin(tilt), atol=1e-12)
    np.testing.assert_allclose(np.abs(np.einsum("vi,vi->v", beam, geometry.normals())), 1, atol=1e-12)
    np.testing.assert_allclose(np.cross(geometry.source, beam), 0, atol=1e-9)  # the isocentre is on the central ray
    flat = laminography(500, 800, ANGLES, 0.0, PANEL)
    for name in ("source", "panel_center", "column_step", "row_step"):
        np.testing.assert_allclose(
            getattr(flat, name), getattr(Geometry.circular(500, 800, ANGLES, PANEL), name), atol=1e-9
        )


def test_chords_in_a_parallel_beam_are_those_of_parallel_rays():
    geometry = parallel(60.0, np.deg2rad([0.0, 30.0, 117.0]), Panel(31, 31, 1.0), np.deg2rad(20))
    center, radius = np.array([4.0, -3.0, 2.0]), 9.0
    rows, columns = np.mgrid[-15:16, -15:16]
    points = (
        geometry.panel_center[:, None, None]
        + columns[..., None] * geometry.column_step[:, None, None]
        + rows[..., None] * geometry.row_step[:, None, None]
    )
    moments = np.cross(points - center, geometry.ray_direction[:, None, None])
    squared = np.maximum(radius**2 - (moments**2).sum(axis=-1), 0)
    within = squared > 0.5
    np.testing.assert_allclose(
        chords(geometry, Sphere(tuple(center), radius))[within], 2 * np.sqrt(squared)[within], atol=2e-5
    )


def test_a_cylinder_along_a_parallel_beam_has_one_length():
    along = parallel(60.0, np.zeros(1), Panel(9, 9, 1.0))
    lengths = chords(along, Cylinder((0.0, 0.0, 0.0), 20.0, 30.0, (1.0, 0.0, 0.0)))
    np.testing.assert_allclose(lengths, 30.0, atol=1e-6)


def test_rays_of_a_parallel_beam_start_far_away():
    geometry = parallel(60.0, ANGLES, PANEL)
    np.testing.assert_allclose(np.linalg.norm(geometry.panel_center - geometry.source, axis=1), FAR, rtol=1e-12)
    assert geometry[1:3].is_parallel
    assert geometry[1:3] == parallel(60.0, ANGLES[1:3], PANEL)
    with pytest.raises(GeometryError, match="unit vectors"):
        Geometry.parallel(
            2 * geometry.ray_direction, geometry.panel_center, geometry.column_step, geometry.row_step, PANEL
        )


@settings(max_examples=15, deadline=None)
@given(angle, angle, angle, st.sampled_from(["circular", "helical", "laminography", "parallel"]))
def test_moving_scene_equals_moving_geometry(a, b, c, kind):
    geometry = {
        "circular": Geometry.circular(60, 100, ANGLES, PANEL),
        "helical": helical(60, 100, ANGLES, 10.0, PANEL),
        "laminography": laminography(60, 100, ANGLES, 0.4, PANEL),
        "parallel": parallel(40, ANGLES, PANEL),
    }[kind]
    turn, shift = rotation_matrix((a, b, c)), np.array([1.0, -0.5, 0.7])
    moved = geometry.moved(np.tile(turn, (len(geometry), 1, 1)), np.tile(shift, (len(geometry), 1)))
    center = np.array([3.0, 1.0, -2.0])
    there = chords(moved, Ellipsoid(tuple(turn @ center + shift), (6.0, 4.0, 3.0), (a, b, c)))
    here = chords(geometry, Ellipsoid(tuple(center), (6.0, 4.0, 3.0)))
    # Of grazing rays, rounding of the far source moves a chord by the square root of 1e-7 mm times its radius.
    np.testing.assert_allclose(there, here, atol=2e-3 if kind == "parallel" else 1e-6)


@settings(max_examples=15, deadline=None)
@given(st.integers(-2, 2), st.integers(-2, 2), st.booleans())
def test_an_offset_panel_is_a_part_of_a_larger_one(columns, rows, far):
    orbit = (
        (lambda panel: parallel(40, ANGLES, panel))
        if far
        else (lambda panel: Geometry.circular(60, 100, ANGLES, panel))
    )
    large, shapes = orbit(Panel(9, 11, (2.0, 3.0))), (Box((2.0, 1.0, 0.0), (9.0, 7.0, 5.0)),)
    part = mounted(orbit(PANEL), Mount((3.0 * columns, 2.0 * rows)))
    seen = chords(large, *shapes)[:, 2 + rows : 7 + rows, 2 + columns : 9 + columns]
    np.testing.assert_allclose(chords(part, *shapes), seen, atol=1e-5 if far else 1e-9)


def test_a_panel_turned_by_half_a_turn_in_its_plane_is_upside_down():
    geometry = Geometry.circular(60, 100, ANGLES, PANEL)
    turned = mounted(geometry, Mount(tilt=(0.0, 0.0, np.pi)))
    shape = Box((4.0, 1.0, -3.0), (9.0, 7.0, 5.0))
    np.testing.assert_allclose(chords(turned, shape), chords(geometry, shape)[:, ::-1, ::-1], atol=1e-9)


@settings(max_examples=25, deadline=None)
@given(small, small, small)
def test_a_tilted_panel_keeps_its_pitch_and_its_centre(u, v, w):
    geometry = Geometry.circular(60, 100, ANGLES, PANEL)
    tilted = mounted(geometry, Mount(tilt=(u, v, w)))
    np.testing.assert_array_equal(tilted.panel_center, geometry.panel_center)
    np.testing.assert_allclose(np.linalg.norm(tilted.column_step, axis=1), 3.0)
    np.testing.assert_allclose(np.linalg.norm(tilted.row_step, axis=1), 2.0)
    np.testing.assert_allclose(np.einsum("vi,vi->v", tilted.column_step, tilted.row_step), 0, atol=1e-12)


def test_turns_of_a_panel_are_right_handed_about_its_own_axes():
    flat = Geometry.circular(60, 100, np.zeros(1), Panel(3, 3, 1.0))  # u = +y, v = -z, w = -x, away from the source
    about_columns, about_rows, in_plane = (mounted(flat, Mount(tilt=tuple(row))) for row in 0.1 * np.eye(3))
    np.testing.assert_allclose(about_columns.row_step[0], [-np.sin(0.1), 0, -np.cos(0.1)], atol=1e-12)
    np.testing.assert_allclose(about_rows.column_step[0], [np.sin(0.1), np.cos(0.1), 0], atol=1e-12)
    np.testing.assert_allclose(in_plane.column_step[0], [0, np.cos(0.1), -np.sin(0.1)], atol=1e-12)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: laminography(500, 400, ANGLES, 0.1, PANEL), "laminography needs 0 < sod < sdd"),
        (lambda: laminography(500, 800, ANGLES, 2.0, PANEL), r"must lie within -90 .. 90 degrees, got 114\.592"),
        (lambda: parallel(0.0, ANGLES, PANEL), "distance > 0, got 0 mm"),
        (lambda: helical(500, 400, ANGLES, 1.0, PANEL), "0 < sod < sdd"),
    ],
)
def test_impossible_orbits_are_refused(make, words):
    with pytest.raises(GeometryError, match=words):
        make()
