"""Curved panels: where their pixels lie, by formulas of a cylinder; modules, and points on them."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from phantomgen.geometry.curved_panel import (
    flat_modules,
    join_modules,
    module_frames,
    on_panel,
    panel_edges,
    ray_directions,
    sees,
    shifted_along,
    split_modules,
)
from phantomgen.geometry.fan_angles import fan_angles, obliquity
from phantomgen.geometry.panel import Curvature, Panel, module_columns
from phantomgen.geometry.panel_mount import Mount, mounted
from phantomgen.geometry.poses import Geometry
from spectra.errors import GeometryError, InputError

SOD, SDD = 595.0, 1085.6
ANGLES = np.array([0.0, 0.3, 2.0, 4.5])


def scanner(modules=46, radius=SDD, columns=736, rows=4):
    panel = Panel(rows, columns, (1.0947, 1.2858), Curvature(radius, modules))
    return Geometry.circular(SOD, SDD, ANGLES, panel)


def positions(geometry):
    """All pixels, (view, row, column, 3)."""
    frames, panel = module_frames(geometry), geometry.panel
    row, column = np.arange(panel.rows), np.arange(panel.columns // panel.modules)
    steps = frames[:, :, 2, None, None] * column[:, None] + frames[:, :, 3, None, None] * row[:, None, None]
    return join_modules(np.moveaxis((frames[:, :, 0] + frames[:, :, 1])[:, :, None, None] + steps, -1, 2).reshape(
        -1, 3, panel.rows, len(column)), panel.modules).transpose(0, 2, 3, 1)  # fmt: skip


@pytest.mark.parametrize("radius", [SDD, 700.0, 3000.0])
def test_modules_of_one_column_lie_on_the_cylinder_at_equal_angles(radius):
    geometry = scanner(736, radius)
    turn = (np.arange(736) - 735 / 2) * 1.2858 / radius
    for view, angle in enumerate(ANGLES):
        outward, tangent = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
        middle = (SOD - SDD + radius) * outward
        expected = middle + radius * (np.sin(turn)[:, None] * tangent - np.cos(turn)[:, None] * outward)
        found = positions(geometry)[view]
        assert found[..., :2] == pytest.approx(np.broadcast_to(expected, (4, 736, 2)), abs=1e-9)
        assert found[:, 5, 2] == pytest.approx((1.5 - np.arange(4)) * 1.0947, abs=1e-12)


def test_rays_to_columns_of_a_panel_around_the_source_have_equal_angles():
    geometry = scanner(736)
    rays = positions(geometry)[0, 0, :, :2] - geometry.source[0, :2]
    steps = np.diff(np.unwrap(np.arctan2(rays[:, 1], rays[:, 0])))
    assert steps == pytest.approx(np.full(735, -1.2858 / SDD), rel=1e-9)  # clockwise, as seen from above


@pytest.mark.parametrize("rows", [4, 64, 512])
def test_chosen_modules_keep_rays_within_a_hundredth_of_a_pixel(rows):
    flat = Panel(rows, 736, (1.0947, 1.2858))
    width = module_columns(flat, SDD)
    assert 1 < width < 736
    coarse, exact = (scanner(736 // w, rows=rows) for w in (width, 1))
    for view, points in enumerate(positions(exact)):
        found = on_panel(coarse[[view]], points[:: max(rows - 1, 1)].reshape(-1, 3))[0].reshape(-1, 736, 3)
        assert np.abs(found[..., 1] - np.arange(736)).max() < 0.012
        wanted = np.arange(0, rows, max(rows - 1, 1))[:, None]
        assert np.abs(found[..., 2] - wanted).max() < 0.012


def test_points_on_the_panel_are_found_where_they_are():
    geometry, rng = scanner(46), np.random.default_rng(2)
    places = positions(geometry)
    for view in range(len(geometry)):
        row, column = rng.integers(4, size=50), rng.integers(736, size=50)
        part = rng.uniform(0.2, 1.0, 50)[:, None]
        points = geometry.source[view] + part * (places[view, row, column] - geometry.source[view])
        found = on_panel(geometry[[view]], points)[0]
        assert found == pytest.approx(np.stack([part[:, 0], column, row], axis=1), abs=1e-7)


@pytest.mark.parametrize("radius", [SDD, 700.0, 3000.0, None])
def test_a_view_sees_the_points_whose_rays_end_on_the_panel(radius):
    """Against projection onto modules of one column; points within a hundredth of a pixel of an edge are left out."""
    geometry = scanner(736, radius) if radius else Geometry.circular(SOD, SDD, ANGLES, Panel(4, 736, (1.0947, 1.2858)))
    points = np.random.default_rng(4).uniform([-800, -400, -6], [400, 400, 6], (300, 3))
    depth, column, row = np.moveaxis(on_panel(geometry, points), -1, 0)
    beyond = np.maximum(np.abs(column - 367.5) - 368, np.abs(row - 1.5) - 2)
    clear, found = np.abs(beyond) > 0.01, sees(geometry, points)
    assert 0.1 < found.mean() < 0.9
    assert clear.mean() > 0.9
    assert np.array_equal(found[clear], ((beyond < 0) & (depth > 0))[clear])


def test_edges_of_a_flat_panel_are_lines_through_its_corners():
    flat = Geometry.circular(500, 800, np.zeros(1), Panel(4, 6, 2.0))
    first, last = panel_edges(flat, 0)
    assert np.array_equal(first, [[-300, -6, 4], [-300, 6, 4]])
    assert np.array_equal(last, [[-300, -6, -4], [-300, 6, -4]])


@pytest.mark.parametrize("modules", [1, 2, 46])
def test_edges_of_a_curved_panel_join_the_outer_corners(modules):
    curved = scanner(modules)
    edges, rows = panel_edges(curved, 2), curved.row_step[2]
    assert edges.shape == (2, modules + 1, 3)
    assert np.diff(edges, axis=0) == pytest.approx(np.broadcast_to(4 * rows, (1, modules + 1, 3)))
    ends = curved.source[2] + ray_directions(curved[[2]], np.array([-0.5, 735.5]), np.array([-0.5, 3.5]))[0]
    assert edges[:, [0, -1]] == pytest.approx(ends, abs=1e-9)


def test_a_flat_panel_has_one_module():
    panel = Panel(3, 5, 1.0)
    geometry = Geometry.circular(SOD, SDD, ANGLES, panel)
    assert flat_modules(geometry) is geometry
    assert module_frames(geometry)[:, 0] == pytest.approx(geometry.ray_frames(), abs=0)


@pytest.mark.parametrize("convert", [np.asarray, torch.as_tensor])
def test_images_are_divided_and_joined(convert):
    images = convert(np.arange(2 * 3 * 4 * 6).reshape(2, 3, 4, 6))
    parts = split_modules(images, 3)
    assert parts.shape == (6, 3, 4, 2)
    assert (parts[4] == images[1, ..., 2:4]).all()
    assert (join_modules(parts, 3) == images).all()
    assert (join_modules(parts.swapaxes(0, 1), 3, views=1) == images.swapaxes(0, 1)).all()


@pytest.mark.parametrize("mount", [Mount((3.0, -2.0)), Mount((3.0, 1.0), (0.02, -0.01, 0.05))])
def test_fan_angles_are_those_of_the_pixels(mount):
    geometry = mounted(scanner(46), mount)
    rays = positions(geometry)[0] - geometry.source[0]
    angle = np.arctan2(rays[..., 1], -rays[..., 0])
    assert fan_angles(geometry.panel, SDD, mount) == pytest.approx(angle, abs=1e-12)
    ratio = np.linalg.norm(rays, axis=-1) / np.linalg.norm(rays[..., :2], axis=-1)
    assert obliquity(geometry.panel, SDD, mount) == pytest.approx(ratio, abs=1e-12)


def test_a_shift_along_the_cylinder_moves_by_columns():
    geometry = scanner(736)
    moved = shifted_along(geometry, 3 * 1.2858)
    assert positions(moved)[:, :, :-3] == pytest.approx(positions(geometry)[:, :, 3:], abs=1e-9)


def test_binning_keeps_the_modules():
    coarse = scanner(46).binned(2)
    assert coarse.panel == Panel(2, 368, (2.1894, 2.5716), Curvature(SDD, 46))
    pairs = positions(scanner(46)).reshape(4, 2, 2, 368, 2, 3).mean(axis=(2, 4))
    assert positions(coarse) == pytest.approx(pairs, abs=1e-9)
    with pytest.raises(GeometryError, match="modules of 1 columns"):
        scanner(736).binned(2)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda: scanner(46, radius=200.0), "turns by"),
        (lambda: scanner(47), "47 equal modules"),
        (lambda: scanner(46, radius=-3.0), "must be positive"),
        (lambda: Panel(4, 8, 1.0, Curvature(9.0, 0)), "at least one module"),
    ],
)
def test_impossible_panels_are_refused(change, sentence):
    with pytest.raises(InputError, match=sentence):
        change()


def test_a_panel_wrapped_past_the_source_is_refused():
    panel = Panel(4, 400, (1.0, 1.0), Curvature(300.0, 400))
    geometry = Geometry.circular(50.0, 60.0, ANGLES, panel)
    moved = replace(geometry, source=geometry.source + 200 * geometry.column_step)
    with pytest.raises(GeometryError, match="wrapped past the source"):
        flat_modules(moved)
    with pytest.raises(GeometryError, match="only a flat one"):
        geometry.ray_frames()
