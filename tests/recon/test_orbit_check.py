"""Orbits that a fit can start from, by what they are and not by their names."""

from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest

from phantomgen.dataset import open_dataset
from phantomgen.geometry import Geometry
from phantomgen.mount import Mount, mounted
from phantomgen.orbits import helical, laminography, parallel, spread_angles
from phantomgen.panel import Panel
from phantomgen.scene import load_scene
from phantomgen.simulate import simulate
from recon.orbit_check import check_full_circle
from recon.run import run
from spectra.errors import GeometryError

PANEL, ANGLES = Panel(8, 10, 2.0), spread_angles(12, 0)
CIRCLE = Geometry.circular(100, 200, ANGLES, PANEL)


@pytest.mark.parametrize(
    ("geometry", "words"),
    [
        (Geometry.circular(100, 200, ANGLES[:1], PANEL), "fewer than two views"),
        (Geometry.circular(100, 200, spread_angles(12, 0, 200.0), PANEL), r"leave a gap of 177 degrees \(circular"),
        (Geometry.circular(100, 200, ANGLES[[0, 1, 2, 3, 6, 7, 8, 9, 10, 11]], PANEL), "a gap of 90 degrees"),
        (helical(100, 200, ANGLES, 20.0, PANEL), "does not keep its distance from the axis and its height"),
        (laminography(100, 200, ANGLES, 0.3, PANEL), "its height"),
        (parallel(50, spread_angles(12, 0, 180.0), PANEL), r"a gap of 195 degrees \(parallel"),
        (mounted(CIRCLE, Mount((5.0, 0.0))), "5 mm off the centre along its rows"),
        (mounted(CIRCLE, Mount(tilt=(0.1, 0.0, 0.0))), "tilted by 5.73 degrees"),
        (mounted(CIRCLE, Mount(tilt=(0.0, 0.0, -0.1))), "tilted by 5.73 degrees"),
        (
            replace(CIRCLE, panel_center=CIRCLE.panel_center * np.linspace(1, 1.5, 12)[:, None]),
            "distance from the source",
        ),
    ],
)
def test_what_would_give_wrong_volumes_is_refused(geometry, words):
    with pytest.raises(GeometryError, match=words) as caught:
        check_full_circle(geometry)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "geometry",
    [
        CIRCLE,
        CIRCLE[[5, 3, 1, 0, 2, 4, 11, 9, 7, 6, 8, 10]],
        mounted(CIRCLE, Mount((0.5, 4.0))),
        parallel(50, ANGLES, PANEL),
        replace(CIRCLE, kind="free", angles=np.full(12, np.nan)),
    ],
    ids=["circle", "any order", "rows", "parallel", "free"],
)
def test_full_circles_are_taken_whatever_they_are_called(geometry):
    check_full_circle(geometry)


def test_a_fit_of_a_short_scan_is_refused_before_any_work(tmp_path, monkeypatch):
    small = ["panel.rows=8", "panel.columns=8", "panel.pitch=25.6", "volume.voxels=8", "flats=2"]
    simulate(
        load_scene("kedge-small", ["geometry.views=4", "geometry.arc=short", "geometry.test_views=0", *small]),
        tmp_path / "a.h5",
    )
    with open_dataset(tmp_path / "a.h5") as dataset:
        monkeypatch.setattr(type(dataset), "load", lambda *_: pytest.fail("read counts"))
        with pytest.raises(GeometryError, match="FDK, needs a full circular orbit"):
            run(dataset, tmp_path, None, None, 0, False, Mock())
