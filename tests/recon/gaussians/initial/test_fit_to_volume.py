"""Gaussians that follow volumes: how close they come, and what they keep."""

from unittest.mock import patch

import numpy as np
import pytest
import torch
from scipy.optimize import minimize
from support.gaussian_scenes import NAMES, small_model

from phantomgen.geometry.voxel_grid import Grid
from recon.gaussians.initial.fit_to_volume import (
    CUTOFF,
    FAINTEST,
    MANY,
    WIDEST,
    _Distance,
    _halfway,
    _means_halfway,
    evaluations_for,
    fit_to_volume,
    metric_of,
)
from recon.gaussians.initial.initialize import initialize
from recon.gaussians.model import Gaussians
from recon.ops.voxelize import mass_within, voxelize_tensor

GRID = Grid.cube(32, 32.0)
METRIC = np.array([[4.0, 1.0], [1.0, 9.0]]) * 1e4
WIDE = 4.5  # standard deviations, where next to nothing is cut off


def ball_and_rod():
    z, y, x = np.meshgrid(*(GRID.axis(name) for name in "zyx"), indexing="ij")
    ball, rod = np.sqrt(x * x + y * y + z * z) < 12, np.sqrt((x - 2) ** 2 + y * y) + 0 * z < 3
    noise = np.random.default_rng(5).normal(scale=2e-4, size=(2, *ball.shape))
    return (np.stack([0.02 * ball, 0.01 * ball + 0.02 * (rod & ball)]) + noise).astype(np.float32)


def distance(gaussians, volumes, metric=METRIC):
    away = gaussians.volume(GRID).astype(float) - volumes
    return 0.5 * np.einsum("mzyx,mn,nzyx->", away, metric / np.trace(metric), away)


@pytest.fixture(scope="module")
def followed():
    volumes, told = ball_and_rod(), []
    start = initialize(volumes, GRID, METRIC, 1.2, NAMES[:2], 0)
    with patch("recon.gaussians.initial.fit_to_volume.CUTOFF", WIDE):
        return volumes, start, fit_to_volume(start, volumes, GRID, METRIC, 30, told.append), told


def test_thirty_evaluations_bring_gaussians_much_closer(followed):
    volumes, start, found, _ = followed
    assert distance(found, volumes) < 0.2 * distance(start, volumes)
    assert len(found) == len(start)
    assert (found.coefficients >= 0).all()


def test_what_is_told_is_the_distance_on_the_way(followed):
    volumes, start, found, told = followed
    assert [told_of.done for told_of in told] == list(range(1, 31))
    assert told[0].residual == pytest.approx(distance(start, volumes), rel=1e-2)
    assert min(told_of.residual for told_of in told) == pytest.approx(distance(found, volumes), rel=5e-2)


def test_it_gets_there_sooner_than_without_knowing_the_curvature_of_a_gaussian(followed):
    """The same number of evaluations spent by scipy's L-BFGS-B on the raw parameters; 30 are too few to tell."""
    volumes, start, _, _ = followed
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
    with patch("recon.gaussians.initial.fit_to_volume.CUTOFF", WIDE):
        assert distance(fit_to_volume(start, volumes, GRID, METRIC, 60), volumes) < other.fun


def test_cutting_gaussians_off_costs_no_mass_and_little_accuracy(followed):
    volumes, start, uncut, _ = followed
    found = fit_to_volume(start, volumes, GRID, METRIC, 30)
    mass, cut = found.volume(GRID).sum(axis=(1, 2, 3)), 1 - mass_within(CUTOFF)
    assert mass == pytest.approx(uncut.volume(GRID).sum(axis=(1, 2, 3)), rel=cut / 3)  # starts scatter by up to cut / 4
    assert distance(found, volumes) < 1.1 * distance(uncut, volumes)


def test_gaussians_that_already_fit_stay(monkeypatch):
    monkeypatch.setattr("recon.gaussians.initial.fit_to_volume.CUTOFF", WIDE)
    monkeypatch.setattr("recon.gaussians.initial.fit_to_volume.HALFWAY_WEIGHT", 0.0)
    start = small_model(1, count=12)
    found = fit_to_volume(start, start.volume(GRID), GRID, np.eye(3), 5)
    assert distance(found, start.volume(GRID), np.eye(3)) < 1e-4 * distance(start, 0 * start.volume(GRID), np.eye(3))


def test_no_gaussian_becomes_a_needle(monkeypatch):
    """One Gaussian that follows a rod of 24 mm would stretch along it, and shine beyond its ends."""
    z, y, x = np.meshgrid(*(GRID.axis(name) for name in "zyx"), indexing="ij")
    rod = 0.02 * (np.hypot(x, y) < 2) * (np.abs(z) < 12)
    volumes = np.stack([rod, 0.5 * rod]).astype(np.float32)
    shape = torch.zeros(1, 3), torch.full((1, 3), np.log(1.5)), torch.tensor([[1.0, 0, 0, 0]])
    start = Gaussians(*shape, torch.tensor([[0.02, 0.01]]), NAMES[:2])

    def longest():
        return float(torch.exp(fit_to_volume(start, volumes, GRID, METRIC, 20).log_scales.max()))

    assert longest() == pytest.approx(1.5 * WIDEST, rel=1e-5)
    monkeypatch.setattr("recon.gaussians.initial.fit_to_volume.WIDEST", 100.0)
    assert longest() > 2 * 1.5 * WIDEST


def test_a_basis_counts_by_its_large_values_and_a_faint_one_no_more_than_it_shows():
    volumes = np.zeros((3, 8, 8, 8), np.float32)
    volumes[0, 2:6], volumes[1, 2:6], volumes[2, 3, 3, :4] = 0.02, 0.005, 1e-7
    fisher = np.array([[4.0, 1.0, 0.5], [1.0, 9.0, 2.0], [0.5, 2.0, 1.0]]) * 1e4
    found = metric_of(volumes, fisher)
    np.testing.assert_array_equal(found, np.diag(np.diag(found)))
    np.testing.assert_allclose(np.sqrt(1 / np.diag(found)), [0.02, 0.005, FAINTEST * 0.02 * 2 / 1], rtol=1e-5)
    assert np.isfinite(metric_of(np.zeros_like(volumes), fisher)).all()


def test_a_step_that_leads_astray_is_not_taken(monkeypatch):
    volumes, told, precondition, calls = ball_and_rod(), [], _Distance.precondition, []

    def sometimes_wild(self, gradient):
        calls.append(1)
        return (1e3 if len(calls) % 5 == 0 else 1) * precondition(self, gradient)

    monkeypatch.setattr(_Distance, "precondition", sometimes_wild)
    monkeypatch.setattr("recon.gaussians.initial.fit_to_volume.CUTOFF", WIDE)
    start = initialize(volumes, GRID, METRIC, 1.2, NAMES[:2], 0)
    found = fit_to_volume(start, volumes, GRID, METRIC, 30, told.append)
    residuals = [told_of.residual for told_of in told]
    assert max(residuals[1:]) > 2 * residuals[0]
    assert distance(found, volumes) < 1.05 * min(residuals)


def test_few_gaussians_take_more_evaluations():
    assert [evaluations_for(n, 60) for n in (1, 682, MANY // 4, MANY, 10 * MANY)] == [150, 150, 120, 60, 60]


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


def test_sheets_within_the_last_voxel_before_a_face_are_less_dense_with_the_second_grid(monkeypatch):
    grid, thirds = Grid.cube(16, 16.0), Grid.cube(48, 16.0)
    volumes = np.zeros((2, *grid.shape), np.float32)
    volumes[:, 4:12, 3:13, 4:11] = np.array([0.02, 0.01])[:, None, None, None]
    start = initialize(volumes, grid, METRIC, 1.0, NAMES[:2], 0)

    def densest():
        return fit_to_volume(start, volumes, grid, METRIC, 60).volume(thirds)[0].max() / 0.02

    with_both = densest()
    monkeypatch.setattr("recon.gaussians.initial.fit_to_volume.HALFWAY_WEIGHT", 0.0)
    assert with_both < min(2.2, 0.7 * densest())


def test_means_halfway_between_voxels_are_those_of_the_voxels_that_meet_there():
    volumes = torch.from_numpy(np.random.default_rng(0).random((1, 3, 4, 5)))
    grid = Grid((3, 4, 5), (1.0, 2.0, 3.0), (0.0, 0.0, 0.0))
    means = _means_halfway(volumes)
    assert tuple(means.shape[1:]) == _halfway(grid).shape
    assert _halfway(grid).origin == (-0.5, -1.0, -1.5)
    assert float(means[0, 1, 2, 3]) == pytest.approx(float(volumes[0, 0:2, 1:3, 2:4].mean()))
