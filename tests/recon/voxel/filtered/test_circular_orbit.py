"""Orbits that filtered back-projection takes, by what they are and not by their names."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.orbit_scenes import FILTERED, GRID, ITERATED, NARROW, circle, short

from phantomgen.geometry.orbits import helical, laminography, parallel, spread_angles
from phantomgen.geometry.panel import Panel
from phantomgen.geometry.panel_mount import Mount, mounted
from phantomgen.geometry.poses import Geometry
from recon.voxel.filtered.circular_orbit import circular_orbit_of
from spectra.errors import GeometryError

PANEL, ANGLES = Panel(8, 10, 2.0), spread_angles(12, 0)
ARCS = {"short scan", "short scan, clockwise", "long arc", "half a turn, parallel"}
CIRCLE = Geometry.circular(100, 200, ANGLES, PANEL)


@pytest.mark.parametrize(
    ("geometry", "words"),
    [
        (CIRCLE[[0]], "fewer than two views"),
        (
            Geometry.circular(100, 200, spread_angles(12, 0, 170.0), PANEL),
            r"arc of 170 degrees is too short \(circ",
        ),
        (CIRCLE[[0, 1, 2, 3, 6, 7, 8, 10, 11]], "leave gaps of 90, 60 degrees"),
        (helical(100, 200, ANGLES, 20.0, PANEL), "does not keep its distance from the axis and its height"),
        (laminography(100, 200, ANGLES, 0.3, PANEL), "its height"),
        (mounted(circle(panel=NARROW), Mount((26.0, 0.0))), "on one side of the axis"),
        (mounted(short(), Mount((6.0, 0.0))), "6 mm off the centre and its arc is not a full circle"),
        (mounted(CIRCLE, Mount(tilt=(1.0, 0.0, 0.0))), "tilted by 57.3 degrees"),
        (
            replace(CIRCLE, panel_center=CIRCLE.panel_center * np.linspace(1, 1.5, 12)[:, None]),
            "distance from the source",
        ),
    ],
)
def test_what_would_give_wrong_volumes_is_refused_in_one_sentence(geometry, words):
    with pytest.raises(GeometryError, match=words) as caught:
        circular_orbit_of(geometry)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", FILTERED)
def test_circles_are_taken(name):
    found = circular_orbit_of(FILTERED[name], GRID)
    assert len(found.angles) == len(FILTERED[name])
    assert found.is_full == (name not in ARCS)
    assert found.is_z_aligned == (name not in {"tilted panel", "panel on its side"})
    assert found.is_centred == ("half-fan" not in name)


@pytest.mark.parametrize("name", ITERATED)
def test_other_orbits_are_not(name):
    with pytest.raises(GeometryError):
        circular_orbit_of(ITERATED[name], GRID)


@pytest.mark.parametrize(
    "geometry",
    [CIRCLE[[5, 3, 1, 0, 2, 4, 11, 9, 7, 6, 8, 10]], parallel(50, ANGLES, PANEL), replace(CIRCLE, kind="free")],
    ids=["any order", "parallel", "free"],
)
def test_full_circles_are_full_whatever_they_are_called(geometry):
    found = circular_orbit_of(geometry)
    assert found.is_full
    assert found.is_centred
    assert found.is_z_aligned


@settings(max_examples=25)
@given(arc=st.floats(225.0, 330.0), start=st.floats(-180.0, 180.0), views=st.integers(20, 60), turned=st.booleans())
def test_an_arc_is_measured_from_its_beginning_with_views_in_the_middle_of_their_steps(arc, start, views, turned):
    geometry = circle(views, arc, start)
    found = circular_orbit_of(geometry[::-1] if turned else geometry, GRID)
    expected = np.deg2rad(arc) * (np.arange(views) + 0.5) / views
    assert found.arc == pytest.approx(np.deg2rad(arc), abs=1e-6)
    np.testing.assert_allclose(found.angles, expected[::-1] if turned else expected, atol=1e-6)


def test_the_fan_need_not_be_wider_than_the_volume():
    scan = circle(72, 205.0)
    with pytest.raises(GeometryError, match="too short"):
        circular_orbit_of(scan)
    near = replace(GRID, shape=(4, 8, 8), origin=(-1.5, -3.5, -3.5))
    assert circular_orbit_of(scan, near).spare == pytest.approx(np.deg2rad(12.5), abs=1e-3)
