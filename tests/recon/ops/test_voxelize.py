import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from scipy.special import ndtr
from support.gaussian_scenes import REGIMES, one_gaussian, random_gaussians
from support.tolerances import TOLERANCES

from phantomgen.geometry.voxel_grid import Grid
from recon.ops.rasterize.reference import lattice_mass
from recon.ops.voxelize import reference, voxelize
from spectra.threads import set_threads

OBLONG = Grid((11, 14, 9), (1.0, 1.2, 0.9), (-5.3, -8.0, -4.0))


def axes_of(grid):
    return tuple(torch.from_numpy(grid.axis(name)) for name in "zyx")


def part_of(grid, low, high):
    origin = tuple(o + s * n for o, s, n in zip(grid.origin, grid.spacing, low, strict=True))
    return Grid(tuple(int(b - a) for a, b in zip(low, high, strict=True)), grid.spacing, origin)


@pytest.mark.parametrize("bases", [1, 3])
@pytest.mark.parametrize("regime", REGIMES)
def test_kernel_gives_the_values_of_the_reference(regime, bases):
    parts = random_gaussians(1, bases=bases, sigma=REGIMES[regime], spread=4.0)
    truth = reference.voxelize(*parts, axes_of(OBLONG), OBLONG.spacing).numpy()
    error = abs(voxelize(*parts, OBLONG, cutoff=5.0) - truth).max() / truth.max()
    assert error < TOLERANCES["kernel_value"]


def test_without_footprint_a_voxel_is_the_value_at_its_centre():
    parts = random_gaussians(2, sigma=(0.7, 2.0), spread=4.0)
    centres, log_scales, quaternions, values = (p.numpy() for p in parts)
    turns = Rotation.from_quat(quaternions[:, [1, 2, 3, 0]]).as_matrix()
    z, y, x = np.meshgrid(*(OBLONG.axis(name) for name in "zyx"), indexing="ij")
    offset = np.stack([x, y, z], axis=-1)[..., None, :] - centres
    u = np.einsum("gji,zyxgj->zyxgi", turns, offset) / np.exp(log_scales)
    expected = np.einsum("zyxg,gm->mzyx", np.exp(-0.5 * (u * u).sum(-1)), values)
    error = abs(voxelize(*parts, OBLONG, footprint=0.0, cutoff=5.0) - expected).max() / expected.max()
    assert error < TOLERANCES["kernel_value"]


@pytest.mark.parametrize("regime", REGIMES)
def test_a_part_of_a_grid_equals_that_part_of_the_whole_bit_for_bit(regime):
    parts = [p.float() for p in random_gaussians(3, sigma=REGIMES[regime], spread=4.0)]
    whole, rng = voxelize(*parts, OBLONG), np.random.default_rng(7)
    for _ in range(15):
        low = rng.integers(0, OBLONG.shape)
        high = rng.integers(low + 1, np.array(OBLONG.shape) + 1)
        some = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
        np.testing.assert_array_equal(voxelize(*parts, part_of(OBLONG, low, high)), whole[:, *some])


def test_any_number_of_threads_gives_the_same_bits():
    parts, volumes = random_gaussians(4, count=40), []
    try:
        for threads in (1, 2, 3):
            set_threads(threads)
            volumes.append(voxelize(*parts, OBLONG))
    finally:
        set_threads(None)
    np.testing.assert_array_equal(volumes[0], volumes[1])
    np.testing.assert_array_equal(volumes[0], volumes[2])


@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (1.5, 0.8, 1.1)])
@pytest.mark.parametrize("sigma", [(0.02,) * 3, (0.3,) * 3, (0.05, 0.05, 1.0), (1.2,) * 3])
def test_mass_is_kept_wherever_a_gaussian_sits(sigma, spacing):
    grid = Grid((14, 15, 16), spacing, tuple(-s * n / 2 for s, n in zip(spacing, (14, 15, 16), strict=True)))
    mass, rng = (2 * np.pi) ** 1.5 * np.prod(sigma), np.random.default_rng(8)
    for centre in rng.uniform(-1, 1, (10, 3)):
        volume = voxelize(*one_gaussian(list(centre), sigma), grid)
        assert volume.sum() * grid.voxel_volume == pytest.approx(mass, rel=TOLERANCES["narrow_voxel_mass"])


@pytest.mark.parametrize("sigma", [0.4, 1.0, 3.0])
def test_truncation_is_a_small_part_of_the_peak(sigma):
    grid, parts = Grid.cube(21, 21.0), one_gaussian([0.0, 0.0, 0.0], sigma)
    truth = reference.voxelize(*parts, axes_of(grid), grid.spacing).numpy()
    assert abs(voxelize(*parts, grid) - truth).max() < TOLERANCES["voxelize_truncation"] * truth.max()


@pytest.mark.parametrize(("sigma", "error"), [(0.1, 0.4), (0.3, 0.05), (0.5, 0.04), (1.0, 0.004), (2.0, 3e-4)])
def test_voxel_mean_is_close_to_the_mean_of_the_density(sigma, error):
    """Means of an upright Gaussian over boxes are products of differences of the error function."""
    grid, rng = Grid.cube(9, 9.0), np.random.default_rng(9)
    for centre in rng.uniform(-1, 1, (8, 3)):
        edges = [grid.axis(name)[:, None] + [-0.5, 0.5] for name in "zyx"]
        means = [np.diff(ndtr((e - c) / sigma), axis=1)[:, 0] for e, c in zip(edges, centre[::-1], strict=True)]
        exact = (np.sqrt(2 * np.pi) * sigma) ** 3 * np.einsum("z,y,x->zyx", *means)
        assert abs(voxelize(*one_gaussian(list(centre), sigma), grid)[0] - exact).max() < error * exact.max()


@pytest.mark.parametrize("axes", [2, 3])
def test_lattice_mass_is_the_sum_over_integer_points(axes):
    rng = np.random.default_rng(10)
    points = np.stack(np.meshgrid(*[np.arange(-12, 13)] * axes, indexing="ij"), axis=-1).reshape(-1, axes)
    for _ in range(10):
        spread = rng.normal(size=(axes, axes)) * 0.5
        covariance, centre = spread @ spread.T + np.eye(axes) / 12, rng.uniform(-0.5, 0.5, axes)
        d = points - centre
        density = np.exp(-0.5 * np.einsum("pi,ij,pj->p", d, np.linalg.inv(covariance), d))
        expected = density.sum() / np.sqrt(np.linalg.det(2 * np.pi * covariance))
        got = lattice_mass(torch.from_numpy(centre[None]), torch.from_numpy(covariance[None]))
        assert float(got) == pytest.approx(expected, abs=TOLERANCES["narrow_voxel_mass"])


def test_a_gaussian_far_outside_leaves_the_grid_empty():
    parts = one_gaussian([1e9, 0.0, 0.0], 1.0)
    assert not voxelize(*parts, OBLONG).any()
