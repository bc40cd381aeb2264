"""Phases that are fitted alone as well: the same rays are set apart, and these find the weight of both fits."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from support.gaussian_scenes import PIXEL, circular, small_model, small_scan, spectral_model

from phantomgen.geometry.voxel_grid import Grid
from recon.gaussians.recipe import FAST
from recon.gaussians.unseen_rays import UnseenRays, with_unseen_rays
from recon.phases.alone import best_weight, with_unseen_rays_of_phases
from recon.phases.model import Alone, PhaseGaussians

VOXEL = PIXEL / 2
GRID = Grid.cube(12, 24.0)


@pytest.fixture(scope="module")
def truth():
    return small_model(1)


@pytest.fixture(scope="module")
def scan(truth):
    return small_scan(truth, circular(16, 16, views=12), spectral_model(3), seed=3)


def test_rays_of_a_phase_are_those_that_a_fit_of_it_alone_sets_apart(scan):
    phase_of_view = np.array([0, 1, 2] * 4)
    apart = with_unseen_rays_of_phases(scan, phase_of_view, VOXEL, FAST).unseen_blocks
    for phase in range(3):
        views = np.flatnonzero(phase_of_view == phase)
        own = with_unseen_rays(scan[views], VOXEL, FAST.seed, FAST.unseen_rays).unseen_blocks
        np.testing.assert_array_equal(apart[views], own)


@pytest.mark.parametrize(("first", "second", "weight"), [(0.8, 1.3, 0.4), (1.0, 1.2, 0.0), (0.7, 1.0, 1.0)])
def test_the_weight_makes_unseen_rays_most_likely(truth, scan, first, second, weight):
    rays = UnseenRays.of(with_unseen_rays(scan, VOXEL, seed=0), VOXEL, 0.0)
    models = [replace(truth, coefficients=factor * truth.coefficients) for factor in (first, second)]
    assert best_weight(*models, rays) == pytest.approx(weight, abs=0.05)


def test_volumes_are_the_weighted_mean_of_both_fits(truth):
    shared = truth.detached()
    phases = PhaseGaussians.begin(shared, shared.coefficients.expand(2, -1, -1).clone(), 6.0)
    twice = replace(shared, coefficients=2 * shared.coefficients)
    found = replace(phases, alone={1: Alone(twice, 0.25)}).volumes(GRID)
    np.testing.assert_allclose(found[1], 1.25 * found[0], rtol=1e-5, atol=1e-9)
    np.testing.assert_array_equal(found[0], phases.volumes(GRID)[0])
    assert torch.equal(phases.at(1).coefficients, shared.coefficients)
