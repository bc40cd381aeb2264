import numpy as np
import pytest
from scipy.ndimage import map_coordinates
from support.gaussian_scenes import GEOMETRIES, SDD, SOD, circular
from support.tolerances import TOLERANCES

from phantomgen.geometry.voxel_grid import Grid
from recon.ops.backproject import backproject
from spectra.errors import InputError
from spectra.threads import set_threads

GRID = Grid((6, 7, 5), (1.1, 0.9, 1.3), (-2.5, -3.0, -2.0))


def voxel_rays(geometry, grid):
    """Column, row and depth at which each view sees each voxel, by solving 3 x 3 systems; (view, 3, z, y, x)."""
    z, y, x = np.meshgrid(*(grid.axis(name) for name in "zyx"), indexing="ij")
    points = np.stack([x, y, z], axis=-1)
    out = []
    for source, first, column_step, row_step in geometry.ray_frames():
        h = np.linalg.solve(np.stack([column_step, row_step, first], axis=1), (points - source)[..., None])[..., 0]
        out.append([h[..., 0] / h[..., 2], h[..., 1] / h[..., 2], h[..., 2]])
    return np.array(out)


@pytest.mark.parametrize("where", GEOMETRIES)
def test_voxels_take_interpolated_pixels_weighted_by_distance(where):
    geometry, rng = GEOMETRIES[where], np.random.default_rng(1)
    images = rng.normal(size=(len(geometry), 2, geometry.panel.rows, geometry.panel.columns)).astype(np.float32)
    scales = rng.uniform(0.4, 0.8, len(geometry))
    expected = np.zeros((2, *GRID.shape))
    for image, scale, (column, row, depth) in zip(images, scales, voxel_rays(geometry, GRID), strict=True):
        for b in range(2):
            expected[b] += (scale / depth) ** 2 * map_coordinates(image[b].astype(float), [row, column], order=1)
    volume = backproject(images, geometry, GRID, scales)
    assert abs(volume - expected).max() < TOLERANCES["backproject"] * abs(expected).max()


def test_a_constant_image_gives_the_sum_of_the_distance_weights():
    geometry = circular(views=8)
    images = np.full((8, 1, geometry.panel.rows, geometry.panel.columns), 3.0, np.float32)
    depth = voxel_rays(geometry, GRID)[:, 2]
    expected = (3 * (SOD / SDD / depth) ** 2).sum(axis=0)
    np.testing.assert_allclose(backproject(images, geometry, GRID, np.full(8, SOD / SDD))[0], expected, rtol=1e-5)


def test_the_isocentre_takes_the_mean_of_the_four_pixels_in_the_middle():
    geometry, one = circular(4, 6, views=1), Grid((1, 1, 1), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0))
    image = np.arange(24, dtype=np.float32).reshape(1, 1, 4, 6)
    volume = backproject(image, geometry, one, np.array([2 * SOD / SDD]))
    assert volume.item() == pytest.approx(4 * np.mean([8, 9, 14, 15]), rel=1e-6)


def test_the_weights_of_a_voxel_are_those_of_its_transpose():
    """<y, B x> with unit images y: what one pixel hands to all voxels, seen from the voxels."""
    geometry, rng = circular(5, 6, views=1), np.random.default_rng(2)
    scale, weights = np.array([0.6]), rng.normal(size=GRID.shape)
    units = np.eye(30, dtype=np.float32).reshape(30, 5, 6)
    handed_out = [(weights * backproject(u[None, None], geometry, GRID, scale)[0]).sum() for u in units]
    column, row, depth = voxel_rays(geometry, GRID)[0]
    c, r = np.floor(column).astype(int), np.floor(row).astype(int)
    expected = np.zeros((5, 6))
    for dr in (0, 1):
        for dc in (0, 1):
            share = abs(1 - dr - (row - r)) * abs(1 - dc - (column - c)) * (0.6 / depth) ** 2
            seen = (c >= 0) & (c <= 4) & (r >= 0) & (r <= 3)
            np.add.at(expected, (r[seen] + dr, c[seen] + dc), (share * weights)[seen])
    np.testing.assert_allclose(np.reshape(handed_out, (5, 6)), expected, atol=1e-4)


def test_voxels_beside_the_panel_get_nothing():
    far = Grid((1, 1, 1), (1.0, 1.0, 1.0), (30.0, 0.0, 0.0))
    geometry = circular(5, 6)
    assert not backproject(np.ones((3, 1, 5, 6), np.float32), geometry, far, np.ones(3)).any()


def test_any_number_of_threads_gives_the_same_bits():
    geometry, volumes = circular(), []
    images = np.random.default_rng(3).normal(size=(3, 2, 13, 16)).astype(np.float32)
    try:
        for threads in (1, 3):
            set_threads(threads)
            volumes.append(backproject(images, geometry, GRID, np.ones(3)))
    finally:
        set_threads(None)
    np.testing.assert_array_equal(*volumes)


@pytest.mark.parametrize(("rows", "columns"), [(1, 5), (5, 1)])
def test_a_panel_without_neighbours_is_refused(rows, columns):
    with pytest.raises(InputError, match="at least 2 x 2"):
        backproject(np.ones((3, 1, rows, columns)), circular(rows, columns), GRID, np.ones(3))
