"""A scan whose panel cuts off its object, against the truth of what all its views see."""

import numpy as np
import pytest
from support.tiny_scans import make

from phantomgen.dataset.reader import open_dataset
from phantomgen.dataset.truth import read_truth
from recon.data.coverage import _beyond, _BlockProjections, coverage, inner_box
from recon.data.measurements import read_measurements
from recon.voxel.iterative.one_step import OneStep
from recon.voxel.margin import margins, with_margin_found

NARROW = "panel={rows: 32, columns: 20, pitch: 6.4}"
SMALL = ("--views", "30", "--test-views", "0", "--set", NARROW)
BESIDE = (
    "objects=[{type: cylinder, material: soft_tissue, radius: 28, length: 70}, {type: cylinder, material: "
    "contrast_high, radius: 9, length: 60, center: [8, 6, 0]}, {type: cylinder, material: soft_tissue, radius: 12, "
    "length: 60, center: [58, 14, 0]}]"
)


def opened(path):
    with open_dataset(path) as dataset:
        truth = read_truth(path)
        assert truth is not None
        return read_measurements(dataset, dataset.splits["train"], 3), dataset.grid, truth.volumes


def error(measured, grid, truth, working):
    """Of Compton in a cylinder that all views see, over the largest value."""
    found = OneStep().reconstruct_counts(measured, working)[:, *inner_box(grid, working)]
    inside = np.hypot(*np.meshgrid(grid.axis("y"), grid.axis("x"), indexing="ij")) < 34
    high = np.abs(grid.axis("z")) < 28
    return np.sqrt(np.mean((found[1] - truth[1])[high][:, inside] ** 2)) / truth[1].max()


@pytest.mark.slow
def test_what_lies_beyond_the_panel_no_longer_spoils_what_lies_within(tmp_path):
    measured, grid, truth = opened(make(tmp_path / "cut.h5", *SMALL, "--set", "volume={voxels: 13, size: 78}"))
    covered = with_margin_found(measured.without_partial_volume(), coverage(measured, grid))
    assert covered.lateral == 1
    off = [error(measured.without_partial_volume(), grid, truth, working) for working in (grid, covered.grid)]
    assert off[1] < 0.5 * off[0]


@pytest.mark.slow
def test_an_object_beside_the_field_of_view_gets_a_margin_that_holds_it(tmp_path):
    measured, grid, truth = opened(
        make(tmp_path / "two.h5", *SMALL, "--set", "volume={voxels: 20, size: 78}", "--set", BESIDE)
    )
    covered, measured = coverage(measured, grid), measured.without_partial_volume()
    found = with_margin_found(measured, covered)
    assert found.grid in margins(measured, covered)[1:]
    off = [error(measured, grid, truth, working) for working in (covered.grid, found.grid)]
    assert off[1] < 0.7 * off[0]


def test_scans_without_truncation_keep_their_grid(tmp_path):
    measured, grid, _ = opened(make(tmp_path / "whole.h5", "--views", "12", "--test-views", "0"))
    covered = coverage(measured, grid)
    assert with_margin_found(measured, covered) is covered
    assert covered.grid == grid


def test_a_panel_beside_the_axis_finds_a_round_object_as_wide_as_a_centred_one_does():
    """Chords of a cylinder of radius 50 mm, seen to 40 mm from the axis on both sides, or on one."""
    widths = []
    for first in (-40.0, -2.0):
        places = np.arange(first + 1, 40, 2)
        across = np.broadcast_to(np.abs(places), (1, 8, len(places)))
        blocks = _BlockProjections(
            0.02 * np.sqrt(50**2 - across**2), np.ones(across.shape, bool), np.zeros(across.shape, bool)
        )
        widths.append(_beyond(blocks, np.array([[False, True]]), across))
    assert abs(widths[0] - 50 / 40) < 0.05
    assert abs(widths[1] - widths[0]) < 0.01
