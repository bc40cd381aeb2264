"""Gaussians fitted to volumes: how close they come, and what does not change."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.optimize import minimize
from support.gaussian_scenes import NAMES, small_model

from phantomgen.geometry.voxel_grid import Grid
from recon.gaussians.initial.fit_to_volume import (
    DEFAULT,
    _Distance,
    evaluations_for,
    fit_to_volume,
    halfway,
    means_halfway,
    metric_of,
)
from recon.gaussians.initial.initialize import initialize
from recon.gaussians.model import Gaussians
from recon.ops.voxelize import mass_within, voxelize_tensor

GRID = Grid.cube(32, 32.0)
METRIC = np.array([[4.0, 1.0], [1.0, 9.0]]) * 1e4
WIDE = replace(DEFAULT, cutoff=4.5)  # standard deviations, where next to nothing is cut off


def ball_and_rod():
    z, y, x = np.meshgrid(*(GRID.axis(name) for name in "zyx"), indexing="ij")
    ball, rod = np.sqrt(x * x + y * y + z * z) < 12, np.sqrt((x - 2) ** 2 + y * y) + 0 * z < 3
    noise = np.random.default_rng(5).normal(scale=2e-4, size=(2, *ball.shape))
    return (np.stack([0.02 * ball, 0.01 * ball + 0.02 * (rod & ball)]) + noise).astype(np.float32)


def distance(gaussians, volumes, metric=METRIC):
    away = gaussians.volume(GRID).astype(float) - volumes
    return 0.5 * np.einsum("mzyx,mn,nzyx->", away, metric / np.trace(metric), away)


@pytest.fixture(scope="module")
def fitted():
    volumes, iterations = ball_and_rod(), []
    start = initialize(volumes, GRID, METRIC, 1.2, NAMES[:2], 0)
    return volumes, start, fit_to_volume(start, volumes, GRID, METRIC, 30, iterations.append, WIDE), iterations


def test_thirty_evaluations_bring_gaussians_much_closer(fitted):
    volumes, start, found, _ = fitted
    assert distance(found, volumes) < 0.2 * distance(start, volumes)
    assert len(found) == len(start)
    assert (found.coefficients >= 0).all()


def test_what_is_told_is_the_distance_on_the_way(fitted):
    volumes, start, found, iterations = fitted
    assert [iteration.done for iteration in iterations] == list(range(1, 31))
    assert iterations[0].residual == pytest.approx(distance(start, volumes), rel=1e-2)
    assert min(iteration.residual for iteration in iterations) == pytest.approx(distance(found, volumes), rel=5e-2)


def test_it_gets_there_sooner_than_without_knowing_the_curvature_of_a_gaussian(fitted):
    """The same number of evaluations spent by scipy's L-BFGS-B on the raw parameters; 30 are too few to tell."""
    volumes, start, _, _ = fitted
    shape, count = start.coefficients.shape, len(start)
    parts = [start.centres, start.log_scales, start.quaternions, start.coefficients / 0.02]
    sizes = [p.numel() for p in parts]

    def split(vector):
        c, s, q, b = np.split(vector.astype(np.float32), np.cumsum(sizes)[:-1])
        tensors = (torch.from_numpy(p) for p in (c, s, q, b))
        c, s, q, b = (t.reshape(count, -1).requires_grad_() for t in tensors)
        return c, s, q, b

    def cost(vector):
        leaves = split(vector)
        found = voxelize_tensor(*leaves[:3], 0.02 * leaves[3], GRID)
        away = found.double() - torch.from_numpy(volumes)
        value = 0.5 * torch.einsum("mzyx,mn,nzyx->", away, torch.from_numpy(METRIC / np.trace(METRIC)), away)
        value.backward()
        return float(value.detach()), np.concatenate([leaf.grad.double().numpy().ravel() for leaf in leaves])

    first = np.concatenate([p.double().numpy().ravel() for p in parts])
    other = minimize(cost, first, jac=True, method="L-BFGS-B", options={"maxfun": 60})
    assert shape[1] == 2
    assert distance(fit_to_volume(start, volumes, GRID, METRIC, 60, settings=WIDE), volumes) < other.fun


def test_cutting_gaussians_off_costs_no_mass_and_little_accuracy(fitted):
    volumes, start, uncut, _ = fitted
    found = fit_to_volume(start, volumes, GRID, METRIC, 30)
    mass, cut = found.volume(GRID).sum(axis=(1, 2, 3)), 1 - mass_within(DEFAULT.cutoff)
    assert mass == pytest.approx(uncut.volume(GRID).sum(axis=(1, 2, 3)), rel=cut / 3)  # starts scatter by up to cut / 4
    assert distance(found, volumes) < 1.1 * distance(uncut, volumes)


def test_gaussians_that_already_fit_stay():
    start = small_model(1, count=12)
    found = fit_to_volume(start, start.volume(GRID), GRID, np.eye(3), 5, settings=WIDE)
    assert distance(found, start.volume(GRID), np.eye(3)) < 1e-4 * distance(start, 0 * start.volume(GRID), np.eye(3))


def test_no_gaussian_becomes_a_needle():
    """One Gaussian that is fitted to a rod of 24 mm would stretch along it, and extend beyond its ends."""
    z, y, x = np.meshgrid(*(GRID.axis(name) for name in "zyx"), indexing="ij")
    rod = 0.02 * (np.hypot(x, y) < 2) * (np.abs(z) < 12)
    volumes = np.stack([rod, 0.5 * rod]).astype(np.float32)
    shape = torch.zeros(1, 3), torch.full((1, 3), np.log(1.5)), torch.tensor([[1.0, 0, 0, 0]])
    start = Gaussians(*shape, torch.tensor([[0.02, 0.01]]), NAMES[:2])

    def longest(settings):
        return float(torch.exp(fit_to_volume(start, volumes, GRID, METRIC, 20, settings=settings).log_scales.max()))

    assert longest(DEFAULT) == pytest.approx(1.5 * DEFAULT.widest, rel=1e-5)
    assert longest(replace(DEFAULT, widest=100.0)) > 2 * 1.5 * DEFAULT.widest


def test_a_basis_counts_by_its_large_values_and_a_faint_one_no_more_than_it_shows():
    volumes = np.zeros((3, 8, 8, 8), np.float32)
    volumes[0, 2:6], volumes[1, 2:6], volumes[2, 3, 3, :4] = 0.02, 0.005, 1e-7
    fisher = np.array([[4.0, 1.0, 0.5], [1.0, 9.0, 2.0], [0.5, 2.0, 1.0]]) * 1e4
    found = metric_of(volumes, fisher)
    np.testing.assert_array_equal(found, np.diag(np.diag(found)))
    np.testing.assert_allclose(np.sqrt(1 / np.diag(found)), [0.02, 0.005, DEFAULT.faintest * 0.02 * 2 / 1], rtol=1e-5)
    assert np.isfinite(metric_of(np.zeros_like(volumes), fisher)).all()


def test_a_step_that_leads_away_is_not_taken(monkeypatch):
    volumes, iterations, precondition, calls = ball_and_rod(), [], _Distance.precondition, []

    def sometimes_wild(self, gradient):
        calls.append(1)
        return (1e3 if len(calls) % 5 == 0 else 1) * precondition(self, gradient)

    monkeypatch.setattr(_Distance, "precondition", sometimes_wild)
    start = initialize(volumes, GRID, METRIC, 1.2, NAMES[:2], 0)
    found = fit_to_volume(start, volumes, GRID, METRIC, 30, iterations.append, WIDE)
    residuals = [iteration.residual for iteration in iterations]
    assert max(residuals[1:]) > 2 * residuals[0]
    assert distance(found, volumes) < 1.05 * min(residuals)


def test_few_gaussians_take_more_evaluations():
    many = DEFAULT.many
    assert [evaluations_for(n, 60) for n in (1, 682, many // 4, many, 10 * many)] == [150, 150, 120, 60, 60]


def test_noise_as_small_as_rounding_moves_the_error_by_less_than_a_tenth_of_a_decibel():
    """Limited-memory BFGS moves it by 0.9 dB."""
    volumes, rng = ball_and_rod(), np.random.default_rng(0)
    z, y, x = np.meshgrid(*(GRID.axis(name) for name in "zyx"), indexing="ij")
    ball, rod = np.sqrt(x * x + y * y + z * z) < 12, np.sqrt((x - 2) ** 2 + y * y) + 0 * z < 3
    clean, errors = np.stack([0.02 * ball, 0.01 * ball + 0.02 * (rod & ball)]), []
    for noise in (0, 1e-6, 1e-6):
        seen = (volumes * (1 + noise * rng.standard_normal(volumes.shape))).astype(np.float32)
        start = initialize(seen, GRID, METRIC, 1.2, NAMES[:2], 0)
        found = fit_to_volume(start, seen, GRID, METRIC, evaluations_for(len(start), 60)).volume(GRID)
        errors.append(20 * np.log10(np.sqrt(np.square(found - clean).mean(axis=(1, 2, 3)))))
    assert np.ptp(errors, axis=0).max() < 0.1


def test_sheets_within_the_last_voxel_before_a_face_are_less_dense_with_the_second_grid():
    grid, thirds = Grid.cube(16, 16.0), Grid.cube(48, 16.0)
    volumes = np.zeros((2, *grid.shape), np.float32)
    volumes[:, 4:12, 3:13, 4:11] = np.array([0.02, 0.01])[:, None, None, None]
    start = initialize(volumes, grid, METRIC, 1.0, NAMES[:2], 0)

    def densest(settings):
        return fit_to_volume(start, volumes, grid, METRIC, 60, settings=settings).volume(thirds)[0].max() / 0.02

    assert densest(replace(DEFAULT, cutoff=3.5, halfway=0.1)) < min(2.2, 0.7 * densest(DEFAULT))


def test_means_halfway_between_voxels_are_those_of_the_voxels_that_meet_there():
    volumes = torch.from_numpy(np.random.default_rng(0).random((1, 3, 4, 5)))
    grid = Grid((3, 4, 5), (1.0, 2.0, 3.0), (0.0, 0.0, 0.0))
    means = means_halfway(volumes)
    assert tuple(means.shape[1:]) == halfway(grid).shape
    assert halfway(grid).origin == (-0.5, -1.0, -1.5)
    assert float(means[0, 1, 2, 3]) == pytest.approx(float(volumes[0, 0:2, 1:3, 2:4].mean()))
