"""A smaller, coarser or moved panel: its pixels lie where the pixels lie that they consist of."""

import numpy as np
import pytest

from phantomgen.geometry.panel import Panel
from phantomgen.geometry.panel_changes import moved_panel, smaller_panel
from phantomgen.geometry.poses import Geometry

PANEL = Panel(6, 12, (0.7, 0.8))
CIRCLE = Geometry.circular(500.0, 800.0, np.array([0.0, 0.4, 2.0]), PANEL)
BEAM = Geometry.parallel(
    np.array([[0.0, 1.0, 0.0]]),
    np.array([[0.3, 50.0, 0.1]]),
    np.array([[0.8, 0.0, 0.0]]),
    np.array([[0.0, 0.0, 0.7]]),
    PANEL,
)


def pixels(geometry):
    """Points of all pixels, (view, row, column, 3)."""
    source, first, column, row = np.moveaxis(geometry.ray_frames(), 1, 0)[:, :, None, None, :]
    rows, columns = np.ogrid[: geometry.panel.rows, : geometry.panel.columns]
    return source + first + columns[None, ..., None] * column + rows[None, ..., None] * row


@pytest.mark.parametrize("geometry", [CIRCLE, BEAM])
@pytest.mark.parametrize(("columns", "factor"), [(slice(0, 12), 2), (slice(2, 10), 1), (slice(1, 7), 3)])
def test_new_pixels_are_the_middles_of_old_ones(geometry, columns, factor):
    old = pixels(geometry)[:, :, columns]
    views, rows, wide, _ = old.shape
    blocks = old.reshape(views, rows // factor, factor, wide // factor, factor, 3).mean(axis=(2, 4))
    new = smaller_panel(geometry, columns, factor)
    assert pixels(new) == pytest.approx(blocks, abs=1e-6 if geometry.is_parallel else 1e-9)
    assert new.panel.pitch == pytest.approx((0.7 * factor, 0.8 * factor))
    assert new.ray_direction is None or np.array_equal(new.ray_direction, geometry.ray_direction)


def test_a_moved_panel_lies_beside_the_true_one_and_the_source_stays():
    moved = moved_panel(CIRCLE, 0.5)
    assert pixels(moved) - pixels(CIRCLE) == pytest.approx(
        np.broadcast_to(0.5 * CIRCLE.column_step[:, None, None], pixels(CIRCLE).shape)
    )
    assert np.array_equal(moved.source, CIRCLE.source)


def test_rows_can_be_left_out_as_columns_can():
    new = smaller_panel(CIRCLE, slice(0, 12), 1, slice(1, 4))
    assert pixels(new) == pytest.approx(pixels(CIRCLE)[:, 1:4], abs=1e-9)


@pytest.mark.parametrize("geometry", [CIRCLE, BEAM])
def test_a_turned_panel_has_its_middle_and_size_and_its_columns_go_towards_its_rows(geometry):
    turned = moved_panel(geometry, 0.0, 30.0)
    assert turned.panel_center == pytest.approx(geometry.panel_center)
    assert turned.normals() == pytest.approx(geometry.normals())
    column, row = (step / np.linalg.norm(step, axis=1)[:, None] for step in (geometry.column_step, geometry.row_step))
    assert turned.column_step == pytest.approx(0.8 * (np.sqrt(0.75) * column + 0.5 * row))
    assert turned.row_step == pytest.approx(0.7 * (np.sqrt(0.75) * row - 0.5 * column))
