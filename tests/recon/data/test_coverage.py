"""Voxels that all views of a scan see."""

import numpy as np
import pytest
from support.tiny_scans import make

from phantomgen.dataset.reader import open_dataset
from phantomgen.geometry.curved_panel import sees
from phantomgen.geometry.voxel_grid import Grid
from recon.data.coverage import seen_by_all_views


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
