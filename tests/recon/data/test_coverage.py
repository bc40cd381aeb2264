"""Voxels that all views of a scan see, and interfaces that none does."""

from dataclasses import replace

import numpy as np
import pytest
from support.tiny_scans import make

from phantomgen.dataset.reader import open_dataset
from phantomgen.geometry.curved_panel import sees
from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from recon.data.coverage import seen_by_all_views, unseen_directions


@pytest.mark.parametrize(
    "panel", ["{rows: 16, columns: 16, pitch: 6.4}", "{rows: 16, columns: 24, pitch: 6.4, curvature: {radius: 800}}"]
)
def test_they_are_on_the_panel_with_all_their_corners(panel, tmp_path):
    path = make(tmp_path / "scan.h5", "--views", "7", "--test-views", "0", "--set", f"panel={panel}")
    grid = Grid((24, 20, 22), (5.0, 6.0, 6.0), (-55.0, -57.0, -63.0))
    with open_dataset(path) as dataset:
        geometry = dataset.geometry
    found = seen_by_all_views(geometry, grid)
    z, y, x = np.meshgrid(
        *(o + s * np.arange(n) for o, s, n in zip(grid.origin, grid.spacing, grid.shape, strict=True)), indexing="ij"
    )
    centres = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    centre = sees(geometry, centres).all(axis=0).reshape(grid.shape)
    assert 0.02 < found.mean() < 0.9 * centre.mean()
    assert not (found & ~centre).any()
    corners = np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3, indexing="ij"), axis=-1).reshape(-1, 3) * grid.spacing[::-1]
    for corner in corners:
        assert sees(geometry, centres[found.ravel()] + corner).all()
    # Blocks of two voxels leave out no more than the border of what is seen.
    inner = np.pad(centre, 2)
    for axis in range(3):
        inner = np.logical_and.reduce([np.roll(inner, shift, axis) for shift in (-2, -1, 0, 1, 2)])
    assert not (inner[2:-2, 2:-2, 2:-2] & ~found).any()


def around(degrees, tilt=0.0):
    """Views from so many angles, which look down on the middle by a tilt [degree]."""
    circle = Geometry.circular(1e6, 1e6 + 300, np.radians(degrees), Panel(8, 8, 1.0))
    down = np.array([np.cos(np.radians(tilt)), np.cos(np.radians(tilt)), 1.0])
    return replace(circle, source=circle.source * down + [0, 0, 1e6 * np.sin(np.radians(tilt))])


@pytest.mark.parametrize("views", [3, 4, 15, 360])
def test_a_circle_sees_all_interfaces(views):
    assert unseen_directions(around(np.arange(views) * 360 / views), Grid.cube(4, 8.0)) == 0


@pytest.mark.parametrize("arc", [30.0, 60.0, 120.0, 179.0])
def test_an_arc_does_not_see_what_faces_the_wedge_it_lacks(arc):
    # The part (180 - arc) / 180 of all directions lies in the wedge; those that views nearly look along count as seen.
    found = unseen_directions(around(np.linspace(0, arc, 721)), Grid.cube(4, 8.0))
    assert max(1 - arc / 180 - 0.06, 0) <= found <= 1 - arc / 180


def test_a_tilted_circle_does_not_see_what_faces_its_axis():
    # The directions within the tilt of the axis: a cap of the sphere.
    found = unseen_directions(around(np.arange(720) / 2, tilt=40.0), Grid.cube(4, 8.0))
    assert found == pytest.approx(1 - np.cos(np.radians(40.0 - np.degrees(0.05))), abs=0.01)
