"""Images of curved panels on flat ones, against closed forms, and filtered back-projection of both."""

import numpy as np
import pytest

from phantomgen.geometry.curved_panel import ray_directions
from phantomgen.geometry.flat_panel import flat_equivalent, on_flat_panel
from phantomgen.geometry.panel import Curvature, Panel, module_columns
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from recon.voxel.filtered.circular_orbit import circular_orbit_of
from recon.voxel.filtered.fdk import fdk

SOD, SDD, PITCH, WIDTH = 300.0, 600.0, 2.0, 8.0
CENTRE = np.array([18.0, -11.0, 3.0])


def scan(views=4, columns=120, rows=24, radius=SDD):
    panel = Panel(rows, columns, PITCH)
    panel = Panel(rows, columns, PITCH, Curvature(radius, columns // module_columns(panel, radius)))
    return Geometry.circular(SOD, SDD, np.arange(views) * 2 * np.pi / views, panel)


def line_integrals(geometry):
    """Line integrals of exp(-|x - c|^2 / (2 s^2)): sqrt(2 pi) s exp(-distance^2 / (2 s^2)) along each ray."""
    rays = ray_directions(geometry, np.arange(float(geometry.panel.columns)), np.arange(float(geometry.panel.rows)))
    rays = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    to = CENTRE - geometry.source[:, None, None]
    squared = (to**2).sum(-1) - (to * rays).sum(-1) ** 2
    return (np.sqrt(2 * np.pi) * WIDTH * np.exp(-squared / (2 * WIDTH**2)))[:, None].astype(np.float32)


@pytest.mark.parametrize("radius", [SDD, 400.0, 900.0])
def test_images_on_the_flat_panel_are_those_of_its_rays(radius):
    geometry = scan(radius=radius)
    images, flat = on_flat_panel(line_integrals(geometry), geometry)
    assert flat.panel.curvature is None
    assert images.shape[2:] == (flat.panel.rows, flat.panel.columns)
    inside = slice(2, -2)  # rows at the border are extended
    rows = slice((flat.panel.rows - geometry.panel.rows) // 2 + 2, (flat.panel.rows + geometry.panel.rows) // 2 - 2)
    expected = line_integrals(flat)
    difference = (images - expected)[:, :, rows, inside]
    assert np.abs(difference).max() < 2e-4 * expected.max()


def test_a_flat_panel_is_returned_as_it_is():
    geometry = Geometry.circular(SOD, SDD, np.array([0.0, 1.0]), Panel(4, 6, PITCH))
    images = np.ones((2, 1, 4, 6), np.float32)
    assert flat_equivalent(geometry) is geometry
    assert on_flat_panel(images, geometry)[0] is images


def test_the_flat_panel_sees_all_rays():
    geometry = scan(radius=500.0)
    flat = flat_equivalent(geometry)
    corners = ray_directions(geometry, np.array([-0.5, 119.5]), np.array([-0.5, 23.5])).reshape(-1, 4, 3)
    for view in range(len(geometry)):
        normal = np.cross(flat.column_step[view], flat.row_step[view])
        axis = flat.panel_center[view] - flat.source[view]
        hits = corners[view] * (axis @ normal / (corners[view] @ normal))[:, None]
        along = (hits - axis) @ flat.column_step[view] / (flat.column_step[view] @ flat.column_step[view])
        across = (hits - axis) @ flat.row_step[view] / (flat.row_step[view] @ flat.row_step[view])
        assert np.abs(along).max() <= flat.panel.columns / 2
        assert np.abs(across).max() <= flat.panel.rows / 2
        assert np.abs(along).max() > flat.panel.columns / 2 - 1


def test_filtered_back_projection_of_a_curved_panel_is_that_of_a_flat_one():
    grid = Grid((4, 40, 40), (2.0, 2.0, 2.0), (-1.0, -39.0, -39.0))
    curved = scan(views=180)
    flat = flat_equivalent(curved)
    found = fdk(line_integrals(curved), curved, grid)
    assert np.abs(found - fdk(line_integrals(flat), flat, grid)).max() < 2e-3
    z, y, x = np.meshgrid(*(grid.axis(name) for name in "zyx"), indexing="ij")
    exact = np.exp(-((x - CENTRE[0]) ** 2 + (y - CENTRE[1]) ** 2 + (z - CENTRE[2]) ** 2) / (2 * WIDTH**2))
    assert np.abs(found[0] - exact).max() < 0.03
    assert circular_orbit_of(curved).is_z_aligned
