"""The objective: its equation on the page and in the code, and its gradients against the equation in float64."""

import re
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from support.gaussian_scenes import PITCH, SDD, SOD, circular, small_model, small_scan, spectral_model
from support.tolerances import TOLERANCES

import recon.gaussians.objective
from phantomgen.geometry.orbits import helical, spread_angles
from phantomgen.geometry.panel import Panel
from phantomgen.geometry.voxel_grid import Grid
from recon.gaussians.fisher import coefficient_curvature
from recon.gaussians.model import PARTS
from recon.gaussians.objective import Objective, seen_gaussians
from recon.gaussians.recipe import Recipe
from recon.gaussians.settings import OptimizerSettings, PriorSettings
from recon.gaussians.state import FitState
from recon.gaussians.voxel_prior import VoxelPrior
from recon.ops.rasterize import Projector, rasterize, reference
from recon.ops.voxelize.reference import voxelize
from spectra.ops.transmit.reference import transmit

PAGE = Path(__file__).parents[3] / "docs" / "explanation" / "the_fit.md"
GRID = Grid((10, 9, 8), (2.0, 2.0, 2.0), (-9.0, -8.0, -7.0))
ETA = 0.02
UNCUT = PriorSettings(cutoff=5.0)  # standard deviations; next to nothing lies beyond


def test_the_page_has_the_equation_of_the_code():
    stated = re.search(r"\\begin\{aligned\}.*?\\end\{aligned\}", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    coded = re.search(r"\\begin\{aligned\}.*?\\end\{aligned\}", str(recon.gaussians.objective.__doc__), re.DOTALL)
    assert stated is not None
    assert coded is not None
    assert stated.group().split() == coded.group().split()


@pytest.fixture(scope="module")
def objective():
    """Counts with statistical weights, and a prior whose trust varies."""
    scan = small_scan(small_model(1), circular(16, 16, views=9), spectral_model(3), seed=3)
    volumes = small_model(1).volume(GRID)
    trust = np.random.default_rng(6).uniform(0.1, 1.0, GRID.shape).astype(np.float32)
    return Objective(scan.weighted(ETA), ETA, VoxelPrior(volumes, GRID, 0.3, trust, settings=UNCUT))


def equation(parts, objective, metric):
    """F as the equation has it, in float64, by brute force."""
    data, prior = objective.data, objective.prior
    frames, panel = torch.from_numpy(data.geometry.ray_frames()), data.geometry.panel
    lengths = reference.rasterize(*parts, frames, panel.rows, panel.columns, 1.0).movedim(1, -1)
    model = data.transmission
    spectrum = torch.from_numpy(model.columns), torch.from_numpy(model.weights), model.starts.tolist()
    expected = transmit(lengths.flatten(0, 2), *spectrum).reshape(*lengths.shape[:3], -1).movedim(-1, 1)
    expected = expected * torch.from_numpy(data.gains * data.exposure[:, :, None, None])
    y, k = torch.from_numpy(data.counts).double(), ETA**-2
    deviance = 2 * (torch.xlogy(y, y / expected) - (y + k) * torch.log((y + k) / (expected + k)))
    data_term = 0.5 * (torch.from_numpy(data.statistical_weights).double() * deviance).sum()
    axes = tuple(torch.from_numpy(GRID.axis(name)) for name in "zyx")
    difference = voxelize(*parts, axes, GRID.spacing) - torch.from_numpy(prior.volumes)
    weighted = torch.einsum("mzyx,mn,nzyx->zyx", difference, metric.double(), difference)
    return data_term + 0.5 * (torch.from_numpy(prior.trust) * weighted).sum()


@pytest.mark.parametrize("strength", [0.3, 30.0])
def test_gradients_of_all_slabs_are_those_of_the_equation(objective, strength, monkeypatch):
    monkeypatch.setattr("recon.gaussians.model.rasterize", partial(rasterize, projector=Projector(cutoff=UNCUT.cutoff)))
    start = small_model(2)
    objective = replace(objective, prior=replace(objective.prior, strength=strength))
    metric = objective.curvature(start, Recipe().optimizer).prior_metric
    exact = [part.detach().double().requires_grad_() for part in start.tensors().values()]
    wanted = torch.autograd.grad(equation(exact, objective, metric) / objective.scale, exact)
    state, every = FitState.begin(start), np.arange(len(objective.data))
    found = [torch.zeros_like(part) for part in start.tensors().values()]
    for step in range(UNCUT.slabs):
        objective.set_gradients(state.gaussians, every, metric, step)
        for total, part in zip(found, state.gaussians.tensors().values(), strict=True):
            total.add_(part.grad / UNCUT.slabs)
    for name, one, other in zip(PARTS, found, wanted, strict=True):
        error = (one - other).norm() / other.norm()
        assert error < TOLERANCES["kernel_gradient"], name


def test_where_few_views_see_a_gaussian_steps_are_those_of_the_views_that_do():
    """Against counts of the views with the centre on the panel; a Gaussian that none sees has the mean of all."""
    narrow = Panel(4, 26, PITCH)
    helix = helical(SOD, SDD, spread_angles(24, 0), 12.0, narrow, -6.0)
    model, flat = small_model(1), torch.tensor([1.0, 1.0, 0.4])
    model = replace(model, centres=torch.cat([flat * model.centres[:-1], torch.tensor([[0.0, 0.0, 40.0]])]))
    apart = model.centres.double().numpy()[None] - helix.source[:, None]
    axis = -helix.source * [1, 1, 0] / SOD
    magnified = SDD / np.einsum("vgi,vi->vg", apart, axis)
    expected = np.abs(apart[..., 2] * magnified) <= 2 * PITCH  # all centres are within the columns
    seen = seen_gaussians(model, helix)
    assert np.array_equal(seen, expected)
    settings = OptimizerSettings(curvature_views=int(np.ceil(24 * seen.mean() / 2)))
    some = np.arange(0, 24, 2)
    of_all, of_some = seen.sum(axis=0), seen[some].sum(axis=0)
    assert of_all[-1] == 0
    assert 0 < of_some[:-1].min() < 12
    objective = Objective(small_scan(model, helix, spectral_model(3), seed=3), ETA, seen=seen)
    found = torch.linalg.inv(objective.curvature(model, settings).inverse.double())
    sums = coefficient_curvature(model, objective.data[some], ETA).double()
    blocks = sums * torch.from_numpy(of_all / np.maximum(of_some, 1))[:, None, None]
    np.testing.assert_allclose(found[:-1].numpy(), blocks[:-1].numpy(), rtol=2e-3, atol=1e-5 * float(blocks.max()))
    mean = torch.diagonal(blocks, dim1=-2, dim2=-1).mean(dim=0)
    np.testing.assert_allclose(torch.diagonal(found[-1]).numpy(), mean.numpy(), rtol=1e-3)

    start = FitState.begin(replace(model, coefficients=0.9 * model.coefficients)).gaussians
    views, gradients = np.array([3, 9, 15, 21]), []
    for each in (objective, replace(objective, seen=None)):
        each.set_gradients(start, views, torch.empty(0), 0)
        gradients.append(start.coefficients.grad.numpy().copy())
    factors = 4 / 24 * of_all / np.maximum(seen[views].sum(axis=0), 1)
    factors[-1] = 1
    assert len(np.unique(factors)) > 2
    np.testing.assert_allclose(gradients[0], factors[:, None] * gradients[1], rtol=1e-6)


def test_where_all_views_see_all_gaussians_nothing_is_scaled():
    assert seen_gaussians(small_model(1), circular(50, 50)) is None
