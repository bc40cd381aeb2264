"""The prior that holds a fit near volumes: its gradients, its curvature, and what it does to noise."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from support.gaussian_scenes import small_model

import recon.gaussians.voxel_prior
from phantomgen.geometry.voxel_grid import Grid
from recon.data.volume_edges import METAL, relative_density
from recon.gaussians.model import PARTS
from recon.gaussians.voxel_prior import DEFAULT, VoxelPrior
from recon.ops.voxelize import mass_within, voxelize

CUTOFF, SLABS = DEFAULT.cutoff, DEFAULT.slabs
GRID = Grid((10, 9, 8), (2.0, 2.0, 2.0), (-9.0, -8.0, -7.0))
WEIGHT = torch.tensor([[2.0, 0.3, 0.1], [0.3, 1.0, 0.2], [0.1, 0.2, 3.0]])


def model(seed):
    return small_model(seed, count=12)


ALONG = 0.1
TRUST = np.random.default_rng(6).uniform(0.1, 1.0, GRID.shape).astype(np.float32)


def near(gaussians):
    """The volumes of a model whose Gaussians end at the cutoff, over the part of their mass within it."""
    parts = (gaussians.centres, gaussians.log_scales, gaussians.quaternions, gaussians.coefficients)
    return voxelize(*parts, GRID, cutoff=CUTOFF) / mass_within(CUTOFF)


def prior(strength=0.3):
    return VoxelPrior(near(model(1)), GRID, strength, TRUST)


def cost(gaussians, held):
    """Half the weighted squared distance, in float64."""
    away = mass_within(CUTOFF) * (near(gaussians).astype(float) - held.volumes)
    return 0.5 * np.einsum("mzyx,mn,nzyx,zyx->", away, WEIGHT.double().numpy(), away, TRUST)


def gradients(gaussians, held):
    """Mean of the gradients of all slabs."""
    found = gaussians.detached()
    for name in PARTS:
        tensor = getattr(found, name).requires_grad_()
        tensor.grad = torch.zeros_like(tensor)
    for step in range(SLABS):
        held.add_gradients(found, WEIGHT / SLABS, step)
    return {name: getattr(found, name).grad for name in PARTS}


@pytest.mark.parametrize("name", PARTS)
def test_slabs_in_turn_give_the_gradient_of_the_whole_distance(name):
    held, start = prior(), model(2)
    ray_gradient = gradients(start, held)[name].double()
    direction = ray_gradient / abs(ray_gradient).max()  # along itself, where the slope is steepest
    size = 1e-2 * getattr(start, name).abs().mean()
    ends = (replace(start, **{name: getattr(start, name) + (s * size * direction).float()}) for s in (1, -1))
    slope = (cost(next(ends), held) - cost(next(ends), held)) / (2 * float(size))
    assert slope == pytest.approx(float((ray_gradient * direction).sum()), rel=2e-2)


def test_the_curvature_is_a_majoriser_of_the_distance_in_the_coefficients():
    held, start = prior(), model(2)
    blocks = torch.eye(3).repeat(len(start), 1, 1)
    both, weight = held.curvature(start, blocks)
    crowd = replace(start, coefficients=torch.ones(len(start), 1)).volume(GRID).astype(float)
    assert weight.numpy() == pytest.approx(0.3 * blocks.sum(dim=0).numpy() / (crowd**2).sum(), rel=1e-5)
    rng = np.random.default_rng(4)
    for _ in range(5):
        step = torch.from_numpy(rng.normal(size=start.coefficients.shape)).float()
        moved = replace(start, coefficients=step).volume(GRID).astype(float)
        bend = np.einsum("mzyx,mn,nzyx,zyx->", moved, weight.double().numpy(), moved, TRUST)
        assert bend <= float(torch.einsum("gm,gmn,gn->", step, both - blocks, step)) * (1 + 1e-5)


def test_a_model_of_these_volumes_has_no_gradient():
    held = prior()
    assert all(abs(ray_gradient).max() < 1e-6 for ray_gradient in gradients(model(1), held).values())


def test_volumes_are_trusted_off_edges():
    grid = Grid.cube(32, 32.0)
    z, y, x = np.meshgrid(*(grid.axis(name) for name in "zyx"), indexing="ij")
    away = np.maximum(np.maximum(abs(x), abs(y)), abs(z)) - 10  # from the faces of a block
    noise = np.random.default_rng(3).normal(scale=2e-4, size=(1, *grid.shape))
    held = VoxelPrior.of_volumes((0.02 * (away < 0) + noise).astype(np.float32), grid, np.eye(1), 0.3, ALONG)
    assert held.trust[away < -3].min() > 0.3
    assert np.median(held.trust[away < -3]) > 0.6
    assert held.trust[(abs(away) < 1) & (abs(y) < 8) & (abs(z) < 8)].max() < 0.2


def test_volumes_are_trusted_off_edges_little_along_them_and_hardly_at_metal():
    volumes = np.random.default_rng(0).normal(0.02, 3e-4, (1, 24, 24, 24)).astype(np.float32)
    volumes[:, 4:10, 4:10, 4:10] = 0.035
    volumes[:, 16:18, 16:18, 16:18] = 0.8
    held = VoxelPrior.of_volumes(volumes, Grid.cube(24, 24.0), np.eye(1), 0.3, ALONG)
    assert held.trust[12, 12, 4] > 0.3
    assert held.trust[4, 7, 7] == pytest.approx(ALONG)
    assert held.trust[16, 16, 16] == pytest.approx(ALONG / (40 / METAL) ** 4, rel=0.05)


def test_density_is_relative_to_that_of_most_voxels_that_hold_something():
    volumes = np.zeros((2, 10, 10, 10), np.float32)
    assert (relative_density(volumes) == 1).all()
    volumes[:, 2:8, 2:8, 2:8] = 0.01
    volumes[:, 5, 5, 5] = 0.3
    found = relative_density(volumes)
    assert found[5, 5, 5] == pytest.approx(30)
    assert found[3, 3, 3] == pytest.approx(1)
    assert found[0, 0, 0] == 0


def test_only_gaussians_that_reach_a_slab_matter_to_it(monkeypatch):
    grid = Grid.cube(32, 32.0)
    start = small_model(5, count=40)
    start = replace(start, centres=start.centres * 2, log_scales=start.log_scales + torch.linspace(-1.5, 0.5, 3))
    held = VoxelPrior(np.zeros((3, *grid.shape), np.float32), grid, 0.3, np.ones(grid.shape, np.float32))
    some, chosen, reaching = gradients(start, held), [], recon.gaussians.voxel_prior._reaching
    monkeypatch.setattr(
        recon.gaussians.voxel_prior,
        "_reaching",
        lambda model, slab, cutoff: chosen.append(slab) or torch.arange(len(model)),
    )
    every = gradients(start, held)
    assert len(chosen) == SLABS
    assert all(len(reaching(start, slab, CUTOFF)) < len(start) for slab in chosen)
    for name in PARTS:
        np.testing.assert_allclose(some[name], every[name], atol=1e-6 * float(every[name].abs().max()))


def test_a_slab_that_no_gaussian_reaches_gives_no_gradient():
    grid = Grid.cube(32, 320.0)
    held = VoxelPrior(np.ones((3, *grid.shape), np.float32), grid, 0.3, np.ones(grid.shape, np.float32))
    assert all(torch.isfinite(ray_gradient).all() for ray_gradient in gradients(model(1), held).values())
