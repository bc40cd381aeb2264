"""A smaller or coarser panel: its pixels lie where the pixels lie that they consist of."""

import numpy as np
import pytest

from phantomgen.degradation.panel import (
    binned_mask,
    binned_mean,
    binned_sum,
    check_bin,
    columns_left,
)
from phantomgen.geometry.panel import Panel
from phantomgen.geometry.panel_changes import moved_panel, smaller_panel
from phantomgen.geometry.poses import Geometry
from spectra.errors import InputError

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


def test_binning_sums_counts_and_joins_masks():
    image = np.arange(24).reshape(4, 6)
    assert binned_sum(image, 2).tolist() == [[14, 22, 30], [62, 70, 78]]
    assert binned_sum(image, 2).sum() == image.sum()
    assert binned_mean(image.astype(float), 2)[0, 0] == 3.5
    mask = np.zeros((4, 6), np.uint32)
    mask[0, 0], mask[1, 1], mask[3, 5] = 2, 64, 8
    assert binned_mask(mask, 2).tolist() == [[66, 0, 0], [0, 0, 8]]


def test_columns_are_cut_off_on_both_sides_alike():
    assert columns_left(128, 0.2) == slice(13, 115)
    assert columns_left(128, 0.0) == slice(0, 128)
    with pytest.raises(InputError, match="leaves none"):
        columns_left(4, 0.9)


def test_a_number_that_does_not_divide_the_panel_is_refused_with_those_that_do():
    with pytest.raises(InputError, match=r"6 x 12 pixels cannot be binned by 4: 2, 3, 6 would"):
        check_bin(6, 12, 4)
    with pytest.raises(InputError, match="no other number would"):
        check_bin(7, 12, 2)
