from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import nnls
from support.gaussian_scenes import circular
from support.voxel_scenes import balls, noisy_images

from phantomgen.geometry.voxel_grid import Grid
from recon.ops.total_variation import total_variation
from recon.voxel.iterative.likelihood import forward
from recon.voxel.iterative.pdhg_tv import GAP_EVERY, PdhgTv, _gradient_noise
from recon.voxel.iterative.ray_weights import RayWeights, noise_information
from spectra.errors import InputError
from spectra.threads import set_threads

METRIC = np.array([[900.0, 300.0], [300.0, 400.0]])
PRECISE = PdhgTv(iterations=1500, tolerance=1e-5, strength=1.0, balance=1.0)


def gaps(method, *problem, **options):
    heard = []
    volumes = method.reconstruct(*problem, on_iteration=heard.append, **options)
    return volumes, [i.residual for i in heard if i.residual is not None]


@pytest.fixture(scope="module")
def small():
    """Two bases in 6^3 voxels, with correlated noise of the metric above."""
    truth, grid = balls(voxels=6, bases=2)
    images, geometry = noisy_images(truth, grid, 1.0, views=6, pixels=8)
    exact = forward(truth, geometry, grid)
    noise = np.einsum("mn,nvrc->mvrc", np.linalg.inv(np.linalg.cholesky(METRIC).T), images - exact)
    return (exact + noise).astype(np.float32), geometry, grid


@pytest.mark.parametrize("start", [None, 0.1])
def test_the_duality_gap_falls_below_its_tolerance(small, start):
    images, geometry, grid = small
    volumes = None if start is None else np.full((2, *grid.shape), start, np.float32)
    _, found = gaps(PRECISE, images, METRIC, geometry, grid, start=volumes)
    assert found[-1] < 1e-5
    assert min(found) > -1e-6
    assert found[0] > 10 * found[-1]


def per_ray(metric, images, rng=None):
    """The same upper triangle for all rays, or a random multiple of it."""
    scale = np.ones(images.shape[1:]) if rng is None else rng.uniform(0, 2, images.shape[1:])
    return metric[np.triu_indices(len(metric))][:, None, None, None] * scale


def test_weights_of_each_ray_reach_the_same_gap(small):
    images, geometry, grid = small
    weights = per_ray(METRIC, images, np.random.default_rng(1))
    assert gaps(replace(PRECISE, tolerance=1e-4), images, weights, geometry, grid)[1][-1] < 1e-4


def test_equal_weights_of_each_ray_are_one_matrix_for_all(small):
    """Filtered and diagonal steps go different ways to the same minimum."""
    images, geometry, grid = small
    one, each = (PRECISE.reconstruct(images, w, geometry, grid) for w in (METRIC, per_ray(METRIC, images)))
    np.testing.assert_allclose(each, one, atol=3e-3 * one.max())


@pytest.mark.parametrize("each", [False, True])
def test_rays_beside_the_volume_leave_no_gap(small, each):
    """Half of the panel sees past a grid of a third of the width; noise there costs as much in both objectives."""
    images, geometry, _ = small
    grid = Grid.cube(3, 4.0)
    assert (forward(np.ones((1, 3, 3, 3), np.float32), geometry, grid) == 0).mean() > 0.3
    weights = per_ray(METRIC, images) if each else METRIC
    assert gaps(PRECISE, images, weights, geometry, grid)[1][-1] < 1e-5


def test_default_settings_reach_their_tolerance(small):
    images, geometry, grid = small
    _, found = gaps(PdhgTv(), images, METRIC, geometry, grid)
    assert found[-1] < PdhgTv().tolerance
    assert len(found) * GAP_EVERY < PdhgTv().iterations


def test_without_total_variation_it_is_non_negative_least_squares(small):
    """One basis, few voxels: scipy's active sets give the minimum exactly."""
    _, geometry, _ = small
    grid = Grid.cube(3, 12.0)
    rng = np.random.default_rng(3)
    images = forward(rng.uniform(-0.02, 0.05, (1, 3, 3, 3)).astype(np.float32), geometry, grid)
    images += 0.01 * rng.standard_normal(images.shape, np.float32)
    system = forward(np.eye(27, dtype=np.float32).reshape(27, 3, 3, 3), geometry, grid).reshape(27, -1).T
    exact = nnls(system.astype(float), images.ravel().astype(float))[0]
    found = replace(PRECISE, strength=0.0).reconstruct(images, np.array([[1e4]]), geometry, grid)
    np.testing.assert_allclose(found.ravel(), exact, atol=1e-4 * exact.max())


def test_no_change_of_the_volumes_lowers_the_objective(small):
    images, geometry, grid = small
    found, _ = gaps(PRECISE, images, METRIC, geometry, grid)
    rows = forward(np.ones((1, *grid.shape), np.float32), geometry, grid)[0]
    size = _gradient_noise(rows, geometry, grid)

    def objective(volumes):
        residual = (forward(volumes, geometry, grid) - images).astype(float)
        square = np.einsum("mvrc,mn,nvrc->", residual, METRIC, residual) / 2
        return square + total_variation(volumes, size * np.linalg.cholesky(METRIC).T, grid)

    least, rng = objective(found), np.random.default_rng(4)
    for scale in (1e-3, 1e-2):
        for _ in range(10):
            other = np.maximum(found + scale * found.max() * rng.standard_normal(found.shape, np.float32), 0)
            assert objective(other) > least * (1 - 1e-6)


def test_units_of_the_bases_do_not_matter(small):
    images, geometry, grid = small
    scale = np.array([1e-3, 50.0])
    method = PdhgTv(iterations=15)
    one = method.reconstruct(images, METRIC, geometry, grid)
    other = method.reconstruct(images * scale[:, None, None, None], METRIC / np.outer(scale, scale), geometry, grid)
    np.testing.assert_allclose(other / scale[:, None, None, None], one, atol=1e-4 * one.max())


def test_a_channel_alone_needs_no_weights():
    """One component, noise found in the images themselves."""
    truth, grid = balls(bases=1)
    images, geometry = noisy_images(truth, grid, 0.1, views=24)
    with_prior, without = (
        PdhgTv(iterations=60, strength=s).reconstruct(images, None, geometry, grid) for s in (1.0, 0.0)
    )
    errors = [np.square(v - truth).mean() for v in (with_prior, without)]
    assert errors[0] < 0.5 * errors[1]


def test_noise_is_found_beside_edges():
    rng = np.random.default_rng(5)
    covariance = np.array([[4e-4, -2e-4], [-2e-4, 9e-4]])
    images = rng.multivariate_normal([0, 0], covariance, (10, 40, 50)).transpose(3, 0, 1, 2)
    images[:, :, 10:30, 15:35] += 1.0
    found = np.linalg.inv(noise_information(images))
    assert np.abs(found - covariance).max() < 0.15 * covariance.max()


def test_proximal_steps_of_rays_minimise_what_they_should():
    rng = np.random.default_rng(6)
    steps = rng.uniform(0.1, 1, (2, 3, 4)).astype(np.float32)
    duals, images, measured = rng.normal(size=(3, 2, 2, 3, 4)).astype(np.float32)
    weights = per_ray(METRIC / 1000, duals, rng)
    found = RayWeights(weights, steps).proximal(duals, images, measured)
    model = RayWeights(weights, steps)
    for v, r, c in np.ndindex(2, 3, 4):
        f = model.each[v, r, c].astype(float)
        step = steps[v, r, c] * model.mean
        moved = duals[:, v, r, c] + step @ images[:, v, r, c]
        system = np.linalg.inv(step) + np.linalg.inv(f)
        right = np.linalg.solve(system, np.linalg.solve(step, moved) - measured[:, v, r, c])
        np.testing.assert_allclose(found[:, v, r, c], right, rtol=2e-3, atol=2e-4)


def test_any_number_of_threads_gives_the_same_bits(small):
    images, geometry, grid = small
    results = []
    try:
        for threads in (1, 3):
            set_threads(threads)
            results.append(PdhgTv(iterations=4).reconstruct(images, METRIC, geometry, grid))
    finally:
        set_threads(None)
    assert np.array_equal(*results)


@pytest.mark.wrong_types
def test_weights_of_another_shape_are_refused():
    images, geometry = np.zeros((1, 3, 4, 4), np.float32), circular(4, 4, 3)
    with pytest.raises(InputError, match=r"got shape \(2, 3, 4\)"):
        PdhgTv().reconstruct(images, np.ones((2, 3, 4)), geometry, Grid.cube(4, 12.0))


@pytest.mark.parametrize(
    "wrong", [{"iterations": 0}, {"strength": -1.0}, {"balance": 0.0}, {"relaxation": 0.9}, {"relaxation": 2.0}]
)
def test_settings_that_cannot_be_are_refused(wrong):
    with pytest.raises(InputError, match=next(iter(wrong))):
        PdhgTv(**wrong)
