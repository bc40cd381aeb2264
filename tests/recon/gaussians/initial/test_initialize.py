import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from support.gaussian_scenes import NAMES

from phantomgen.geometry.voxel_grid import Grid
from recon.gaussians.initial.initialize import initialize
from recon.gaussians.settings import PlacementSettings

GRID = Grid((24, 26, 28), (1.0, 1.0, 1.0), (-11.5, -12.5, -13.5))
FISHER = np.array([[4.0, 1.0], [1.0, 9.0]]) * 1e4


def ball(grid, radius=8.0, values=(0.01, 0.02)):
    z, y, x = np.meshgrid(*(grid.axis(name) for name in "zyx"), indexing="ij")
    inside = np.sqrt(x * x + y * y + z * z) < radius
    return np.stack([value * inside for value in values]).astype(np.float32)


@pytest.fixture(scope="module")
def noisy():
    """A ball of radius 20 in 48^3 voxels with 5 % noise, and the Gaussians made from it."""
    grid = Grid.cube(48, 48.0)
    clean = ball(grid, 20.0)
    noise = np.random.default_rng(1).normal(size=clean.shape) * 0.05 * clean.max(axis=(1, 2, 3), keepdims=True)
    return grid, clean, start((clean + noise).astype(np.float32), grid)


def start(volumes, grid=GRID, spacing=1.5, fisher=FISHER, seed=0):
    return initialize(volumes, grid, fisher, spacing, NAMES[: len(volumes)], seed)


@pytest.mark.parametrize("spacing", [1.5, 3.0])
def test_points_keep_their_distance_and_fill_the_object(spacing):
    centres = start(ball(GRID), spacing=spacing).centres.numpy()
    assert cKDTree(centres).query(centres, k=2)[0][:, 1].min() >= spacing * (1 - 1e-6)
    inside = np.argwhere(ball(GRID, 7.0)[0] > 0) + np.array(GRID.origin)
    # no hole larger than the coarsest spacing
    assert cKDTree(centres).query(inside[:, ::-1])[0].max() < 3.5 * spacing


@pytest.mark.parametrize("count", [50, 400])
def test_about_as_many_gaussians_are_placed_as_are_wanted(count):
    found = initialize(ball(GRID), GRID, FISHER, 1.5, NAMES[:1], 0, PlacementSettings(count=count))
    assert len(found) == pytest.approx(count, rel=0.02, abs=3)


def test_edges_are_filled_more_densely_than_the_inside(noisy):
    centres = noisy[2].centres.numpy()
    radius, nearest = np.linalg.norm(centres, axis=1), cKDTree(centres).query(centres, k=2)[0][:, 1]
    assert 1.5 < nearest[abs(radius - 20) < 1].mean() < 1.8
    assert nearest[radius < 10].mean() > 3


def test_gaussians_on_an_edge_lie_flat_on_it(noisy):
    gaussians = noisy[2]
    centres, turns = gaussians.centres.numpy(), gaussians.quaternions.numpy()
    edge = abs(np.linalg.norm(centres, axis=1) - 20) < 0.5
    thin = Rotation.from_quat(turns[edge][:, [1, 2, 3, 0]]).as_matrix()[:, :, 2]
    outwards = centres[edge] / np.linalg.norm(centres[edge], axis=1, keepdims=True)
    assert np.median(abs((thin * outwards).sum(axis=1))) > 0.97
    scales = np.exp(gaussians.log_scales.numpy()[edge])
    assert (scales[:, 2] < 0.75 * scales[:, 0]).all()


def test_the_first_volume_resembles_what_it_was_made_from(noisy):
    grid, clean, gaussians = noisy
    for volume, right in zip(gaussians.volume(grid), clean, strict=True):
        assert volume[right > 0].mean() == pytest.approx(right.max(), rel=0.15)
        assert np.sqrt(((volume - right) ** 2).mean()) < 0.15 * right.max()


def test_the_seed_decides():
    one, same, other = (start(ball(GRID), seed=seed) for seed in (3, 3, 4))
    for name in ("centres", "log_scales", "quaternions", "coefficients"):
        assert torch.equal(getattr(one, name), getattr(same, name))
    assert one.centres.shape != other.centres.shape or not torch.equal(one.centres, other.centres)


def test_the_choice_of_bases_does_not_move_the_points():
    """Volumes in another basis, with the Fisher matrix that goes with it, show the same edges."""
    turn = np.array([[1.0, 0.5], [-0.3, 2.0]])
    volumes = ball(GRID)
    turned = np.einsum("nm,mzyx->nzyx", np.linalg.inv(turn), volumes).astype(np.float32)
    one, other = start(volumes), start(turned, fisher=turn.T @ FISHER @ turn)
    assert len(other) == pytest.approx(len(one), rel=0.02)


def test_an_all_zero_volume_gives_gaussians_everywhere_that_carry_nothing():
    gaussians = start(np.zeros((2, 8, 8, 8), np.float32), Grid.cube(8, 8.0))
    assert len(gaussians) > 1
    assert not gaussians.coefficients.any()
    assert torch.isfinite(gaussians.log_scales).all()


@pytest.mark.parametrize("shape", [(1, 1, 1), (1, 6, 6), (5, 1, 1)])
def test_grids_of_one_voxel_along_an_axis(shape):
    gaussians = start(np.full((2, *shape), 0.02, np.float32), Grid(shape, (1.0,) * 3, (0.0,) * 3))
    assert len(gaussians) >= 1
    for name in ("centres", "log_scales", "quaternions", "coefficients"):
        assert torch.isfinite(getattr(gaussians, name)).all()
    assert (gaussians.coefficients > 0).all()


def test_one_basis():
    assert start(ball(GRID)[:1], fisher=FISHER[:1, :1]).coefficients.shape[1] == 1


def test_soft_tissue_is_filled_beside_metal():
    body, metal = ball(GRID, 10.0), ball(GRID, 5.0, (1.0, 0.2))
    centres = start(np.maximum(body, metal)).centres.numpy()
    soft = np.argwhere((ball(GRID, 9.0)[0] > 0) & (ball(GRID, 6.0)[0] == 0)) + np.array(GRID.origin)
    assert cKDTree(centres).query(soft[:, ::-1])[0].max() < 5.0


def test_one_voxel_more_moves_the_points_near_it_and_no_others():
    one = ball(GRID)
    other = one.copy()
    other[:, 4, 13, 14] = 0.5 * one.max(axis=(1, 2, 3))  # a voxel beside the ball, 8 mm from its centre
    there, here = (start(volumes).centres.numpy() for volumes in (one, other))
    far = np.array([14, 13, 4])[None] + np.array(GRID.origin)[::-1]
    kept = [points[np.linalg.norm(points - far, axis=1) > 9] for points in (there, here)]
    assert len(kept[0]) > 30
    np.testing.assert_array_equal(*kept)


def test_a_part_of_the_grid_holds_the_same_points():
    volumes, part = ball(GRID), (slice(2, 23), slice(3, 24), slice(4, 27))
    inner = start(np.ascontiguousarray(volumes[:, *part]), GRID.part(part))
    np.testing.assert_allclose(inner.centres, start(volumes).centres, atol=1e-6)


@pytest.mark.parametrize("voxels", [12, 48])
def test_edges_everywhere_get_as_many_gaussians_as_edges_somewhere(voxels):
    """Slabs of two values, two voxels thick, in a cube: most voxels lie at an edge, and the median gradient is one."""
    grid = Grid.cube(voxels, float(voxels))
    value = np.where(np.arange(voxels) // 2 % 2, 0.01, 0.02)
    volumes = np.broadcast_to(value[:, None, None], grid.shape)[None].astype(np.float32)
    assert len(start(volumes, grid, spacing=1.0, fisher=np.array([[4e4]]))) > 0.3 * voxels**3
