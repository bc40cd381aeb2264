"""Exact means over voxels of another grid."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from phantomgen.geometry.voxel_grid import Grid
from phantomgen.ops.box_average import PARALLEL, box_average, covered_part

FINE = Grid((4, 6, 8), (1.0, 2.0, 0.5), (-1.5, -5.0, -1.75))  # 4 x 12 x 4 mm around the isocentre
VALUES = np.random.default_rng(0).normal(size=FINE.shape)


def test_whole_multiples_are_block_means():
    coarse = Grid((2, 2, 2), (2.0, 6.0, 2.0), (-1.0, -3.0, -1.0))
    blocks = VALUES.reshape(2, 2, 2, 3, 2, 4).mean(axis=(1, 3, 5))
    np.testing.assert_allclose(box_average(VALUES, FINE, coarse), blocks, rtol=1e-12)
    assert covered_part(FINE, coarse) == pytest.approx(1)


def test_outside_is_zero_and_half_a_voxel_counts_half():
    shifted = Grid(FINE.shape, FINE.spacing, (FINE.origin[0] + 2.5, *FINE.origin[1:]))
    found = box_average(VALUES, FINE, shifted)
    np.testing.assert_allclose(found[0], (VALUES[2] + VALUES[3]) / 2, rtol=1e-12)
    np.testing.assert_allclose(found[1], VALUES[3] / 2, rtol=1e-12)
    assert not found[2:].any()
    assert covered_part(FINE, shifted) == pytest.approx(1.5 / 4)


@example(2.0, 1e-9)
@given(st.floats(0.3, 3.0), st.floats(-0.9, 0.9))
def test_the_integral_is_kept_on_any_grid_that_holds_the_volume(spacing, shift):
    count = int(14 / spacing) + 3
    grid = Grid((count,) * 3, (spacing,) * 3, tuple(shift - (count - 1) / 2 * spacing for _ in range(3)))
    found = box_average(VALUES, FINE, grid)
    # Slivers below PARALLEL of a voxel count nowhere: at two ends of three axes, each from one layer of voxels at most.
    slivers = 6 * PARALLEL * spacing * np.abs(VALUES).sum() * FINE.voxel_volume / min(FINE.spacing)
    assert found.sum() * grid.voxel_volume == pytest.approx(VALUES.sum() * FINE.voxel_volume, abs=slivers)


def test_means_agree_with_brute_force():
    grid = Grid((3, 3, 3), (1.1, 3.3, 1.3), (-0.9, -3.0, -1.0))
    fine = 40  # points along an axis of each voxel
    found = box_average(VALUES, FINE, grid)
    for index in np.ndindex(grid.shape):
        inside = []
        for axis in range(3):
            centre = grid.origin[axis] + grid.spacing[axis] * index[axis]
            points = centre + grid.spacing[axis] * ((np.arange(fine) + 0.5) / fine - 0.5)
            numbers = np.floor((points - FINE.origin[axis]) / FINE.spacing[axis] + 0.5).astype(int)
            inside.append(
                np.bincount(numbers[(numbers >= 0) & (numbers < FINE.shape[axis])], minlength=FINE.shape[axis])
            )
        weights = np.einsum("z,y,x->zyx", *inside) / fine**3
        assert found[index] == pytest.approx((weights * VALUES).sum(), abs=0.05)
