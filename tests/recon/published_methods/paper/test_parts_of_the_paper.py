"""The model, its start and its controls, each against a closed form."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import expit
from support.gaussian_scenes import circular

from phantomgen.geometry.voxel_grid import Grid
from recon.published_methods.paper.adam import EdgeAdam, GroupedAdam, rates
from recon.published_methods.paper.density_control import PanelGradient, choose, densify, reset_fractions
from recon.published_methods.paper.initialize import (
    DENSE,
    HIGH,
    MIDDLE,
    MOST_EDGE,
    first_gaussians,
    fractions_of_density,
    units_of,
)
from recon.published_methods.paper.learned_edge import KEdge
from recon.published_methods.paper.model import FactorisedGaussians, Units
from recon.published_methods.paper.projections import detector_gradient, line_integrals
from recon.published_methods.paper.recipe import COMPONENTS, PaperRecipe, Rate, checked
from spectra.errors import InputError

GRID = Grid.cube(16, 32.0)
UNITS = Units.of(GRID, 0.05, 0.0005, 0.5)
RECIPE = PaperRecipe(steps=300)


def some_gaussians(count=9, bases=3, seed=0, sigma=(0.5, 3.0)):
    rng = np.random.default_rng(seed)
    fractions = rng.dirichlet(np.ones(bases), count)
    centres, sigmas = rng.uniform(-9, 9, (count, 3)), rng.uniform(*sigma, (count, 3))
    return FactorisedGaussians.of(centres, rng.uniform(0.001, 0.08, count), sigmas, fractions, UNITS)


def test_there_is_no_component_of_another_name():
    with pytest.raises(
        InputError, match="--without colour: there is no such component; choose from kedge-freezing, tv"
    ):
        checked(["tv", "colour"])
    assert checked(["tv", "kedge-freezing", "tv"]) == ("kedge-freezing", "tv")


@pytest.mark.parametrize("name", ["steps", "gaussians", "edge_slope"])
def test_a_recipe_refuses_what_is_not_positive(name):
    with pytest.raises(InputError, match=f"recipe {name} must be positive, got 0"):
        PaperRecipe(**{name: 0})


def test_schedules_shrink_with_the_steps_and_the_recipe_says_so():
    recipe = PaperRecipe(steps=3000, without=("tv",))
    assert [recipe.scaled(n) for n in (2000, 100, 1)] == [200, 10, 1]
    assert (
        recipe.description
        == "recipe of the paper: 3000 steps in place of 30000, all schedules scaled to match; without tv"
    )
    assert PaperRecipe().description == "recipe of the paper: 30000 steps"


@given(st.integers(2, 3), st.integers(0, 2**31))
def test_fractions_lie_on_the_simplex_and_factors_return_to_what_they_were_made_of(bases, seed):
    rng = np.random.default_rng(seed)
    fractions, density = rng.dirichlet(np.ones(bases), 5), np.exp(rng.uniform(-8, 0, 5))
    sigma = np.exp(rng.uniform(np.log(0.02), np.log(15), (5, 3)))
    model = FactorisedGaussians.of(np.zeros((5, 3)), density, sigma, fractions, UNITS)
    np.testing.assert_allclose(model.material_fractions().sum(dim=1), 1, rtol=1e-6)
    np.testing.assert_allclose(
        model.coefficients(UNITS), density[:, None] * fractions, rtol=2e-3, atol=2e-4 * density.max()
    )
    np.testing.assert_allclose(model.sigma(UNITS), sigma, rtol=1e-3)


def test_standard_deviations_stay_between_their_bounds_whatever_the_parameters():
    model = some_gaussians()
    for value in (-1e3, 1e3):
        sigma = replace(model, scales=torch.full_like(model.scales, value)).sigma(UNITS)
        assert (sigma >= 0.999 * 0.0005 * 32).all()
        assert (sigma <= 1.001 * 0.5 * 32).all()


def test_coefficients_go_to_the_raw_basis_by_the_matrix():
    model, matrix = some_gaussians(), torch.tensor([[1.0, 0, 0], [0, 1, 0], [-0.2, -1.1, 2]], dtype=torch.float64)
    raw = model.gaussians(UNITS, matrix, ("a", "b", "c"))
    np.testing.assert_allclose(raw.coefficients, model.coefficients(UNITS).double() @ matrix, rtol=1e-5, atol=1e-8)
    assert not raw.coefficients.requires_grad


def test_first_fractions_follow_the_formulas_at_the_quantiles():
    density = np.random.default_rng(1).lognormal(0, 0.5, 2001)
    order = np.argsort(density)
    two, three = fractions_of_density(density, 2), fractions_of_density(density, 3)
    np.testing.assert_allclose(two.sum(axis=1), 1)
    np.testing.assert_allclose(three.sum(axis=1), 1)
    at = [order[round(q * 2000)] for q in (MIDDLE, HIGH, DENSE)]
    np.testing.assert_allclose(two[at[:2], 0], [0.5, 0.9])
    assert three[at[2], 2] == pytest.approx(MOST_EDGE * 0.5 * two[at[2], 0])
    np.testing.assert_allclose(three[:, 0] + three[:, 2], two[:, 0])
    assert (np.diff(three[order, 2]) >= 0).all()


def test_first_fractions_survive_an_object_of_one_density():
    fractions = fractions_of_density(np.full(7, 0.02), 3)
    np.testing.assert_allclose(fractions, np.tile([0.5 - MOST_EDGE * 0.25, 0.5, MOST_EDGE * 0.25], (7, 1)))


@pytest.mark.parametrize(("by_density", "gate", "expected"), [(False, True, 1 / 3), (True, False, 0.1)])
def test_first_fractions_without_density_or_gate(by_density, gate, expected):
    density = np.random.default_rng(2).lognormal(0, 0.5, 50)
    fractions = fractions_of_density(density, 3, by_density, gate)
    whole = 1.0 if not by_density else fractions[:, 0] + fractions[:, 2]
    np.testing.assert_allclose(fractions[:, 2] / whole, expected)


@pytest.mark.parametrize("limit", [30, 10_000])
def test_gaussians_start_at_voxels_that_are_dense_enough(limit):
    volume = np.zeros(GRID.shape, np.float32)
    volume[4:9, 5:8, 3:6] = 0.04
    recipe, means = replace(RECIPE, gaussians=limit), np.array([2.0, 1.0])
    units = units_of(volume, GRID, recipe)
    model = first_gaussians(volume, GRID, means, units, recipe)
    assert (len(model), units.density) == (min(limit, 45), pytest.approx(0.04))
    voxels = (model.centres.numpy() - GRID.origin[0]) / GRID.spacing[0]
    assert (volume[tuple(np.round(voxels[:, ::-1]).astype(int).T)] > 0).all()
    np.testing.assert_allclose(voxels, np.round(voxels), atol=1e-5)
    attenuated = model.coefficients(units).double().numpy() @ means
    np.testing.assert_allclose(attenuated, 0.15 * 0.04, rtol=1e-3)
    if limit > 45:  # neighbours are a voxel away, three of them everywhere in a block
        np.testing.assert_allclose(model.sigma(units), GRID.spacing[0], rtol=1e-3)


def test_an_empty_scan_is_refused():
    with pytest.raises(InputError, match="the scan shows nothing"):
        units_of(np.zeros(GRID.shape), GRID, RECIPE)


def test_rates_fall_exponentially_and_move_each_group_by_its_own():
    model = some_gaussians()
    adam = GroupedAdam(model, {name: Rate(0.1, 0.001) for name in model.tensors()} | {"densities": Rate(0.2, 0.2)})
    for fraction, expected in ((0.0, 0.1), (0.5, 0.01), (1.0, 0.001)):
        before = {name: value.detach().clone() for name, value in adam.model.tensors().items()}
        sum(value.sum() for value in adam.model.tensors().values()).backward()
        adam.step(fraction)
        for name, value in adam.model.tensors().items():  # a constant gradient moves Adam by its rate
            wanted = 0.2 if name == "densities" else expected
            np.testing.assert_allclose((before[name] - value).detach(), wanted, rtol=2e-3)


def test_rates_without_decay_stay_and_centres_move_in_mm():
    found = rates(replace(RECIPE, without=("rate-decay", "fraction-rate")), UNITS)
    assert found["centres"] == Rate(2e-4 * 16, 2e-4 * 16)
    assert found["fractions"] == Rate(1e-2, 1e-2)


def test_rows_keep_their_moments_and_new_ones_have_none():
    adam = GroupedAdam(some_gaussians(), rates(RECIPE, UNITS))
    (adam.model.centres**2).sum().backward()
    adam.adam.step()
    moments, centres = adam.adam.state[adam.model.centres]["exp_avg"].clone(), adam.model.centres.detach().clone()
    new = {name: value.detach()[:2].clone() for name, value in adam.model.tensors().items()}
    adam.replace_rows(torch.tensor([8, 1]), new)
    assert torch.equal(adam.model.centres.detach(), torch.cat([centres[[8, 1]], new["centres"]]))
    expected = torch.cat([moments[[8, 1]], torch.zeros(2, 3)])
    assert torch.equal(adam.adam.state[adam.model.centres]["exp_avg"], expected)


def test_small_gaussians_are_cloned_and_large_ones_split_by_thresholds_of_their_own():
    panel_gradient = torch.tensor([4e-5, 6e-5, 3e-5, 2e-5])
    sigma = torch.tensor([1.0, 1.0, 4.0, 4.0])[:, None].expand(4, 3)  # large: above a tenth of 32
    choice = choose(panel_gradient, sigma, 32.0, RECIPE)
    assert choice.clone.tolist() == [False, True, False, False]
    assert choice.split.tolist() == [False, False, True, False]
    assert not choose(panel_gradient, sigma, 32.0, replace(RECIPE, without=("split-threshold",))).split.any()


def test_where_there_is_no_room_for_all_the_strongest_are_taken():
    panel_gradient = torch.tensor([1e-4, 3e-4, 2e-4, 5e-4])
    choice = choose(panel_gradient, torch.ones(4, 3), 32.0, replace(RECIPE, most=6))
    assert choice.clone.tolist() == [False, True, False, True]


@pytest.mark.parametrize("sigma", [(0.5, 1.5), (4.0, 6.0)])
def test_density_is_shared_by_clones_and_halves(sigma):
    model = some_gaussians(sigma=sigma)
    before = {name: value.clone() for name, value in model.tensors().items()}
    adam, panel_gradient = GroupedAdam(model, rates(RECIPE, UNITS)), PanelGradient(9)
    panel_gradient.add(torch.tensor([1.0] * 3 + [0.0] * 6))
    densify(adam, panel_gradient, GRID, UNITS, replace(RECIPE, without=("pruning",)), np.random.default_rng(3))
    after = adam.model
    assert len(after) == 12
    total = torch.nn.functional.softplus(before["densities"]).sum()
    torch.testing.assert_close(after.density().detach().sum(), total)
    if sigma[0] < 3:  # clones sit where their parents are
        assert torch.equal(after.centres[-3:].detach(), before["centres"][:3])
        return
    parents = replace(model, **{name: value[:3] for name, value in before.items()})
    for halves in (slice(6, 9), slice(9, 12)):
        np.testing.assert_allclose(after.sigma(UNITS)[halves].detach(), parents.sigma(UNITS) / 1.6, rtol=1e-4)
        offset = (after.centres[halves].detach() - parents.centres) / parents.sigma(UNITS)
        assert 0 < float(offset.norm(dim=1).max()) < 5


def test_gaussians_without_density_or_outside_the_grid_are_pruned():
    model = some_gaussians()
    model.centres[2] = torch.tensor([16.1, 0, 0])
    model.densities[5] = -20.0
    kept = [i for i in range(9) if i not in (2, 5)]
    expected = model.centres[kept].clone()
    adam = GroupedAdam(model, rates(RECIPE, UNITS))
    densify(adam, PanelGradient(9), GRID, UNITS, RECIPE, np.random.default_rng(4))
    assert torch.equal(adam.model.centres.detach(), expected)


def test_a_reset_draws_fractions_half_way_to_equal_ones_and_leaves_density():
    adam = GroupedAdam(some_gaussians(), rates(RECIPE, UNITS))
    fractions, density = adam.model.material_fractions().detach(), adam.model.density().detach()
    reset_fractions(adam)
    np.testing.assert_allclose(adam.model.material_fractions().detach(), fractions / 2 + 1 / 6, rtol=1e-5)
    assert torch.equal(adam.model.density(), density)


def test_the_edge_follows_its_gradient_and_stays_on_the_energy_grid():
    edge = KEdge.at(20.01, 1.0)
    adam = EdgeAdam(edge, RECIPE)
    for expected in (20.0, 20.0):  # a step of 0.02 keV down is stopped at the lowest energy
        edge.energy.backward()
        adam.step()
        assert edge.energy.item() == pytest.approx(expected)
    energy = torch.tensor([30.0, 50.0], dtype=torch.float64)
    np.testing.assert_allclose(KEdge.at(40.0, 0.5).column(energy), expit([-5, 5]))


def test_the_pull_on_the_panel_is_the_derivative_by_normalised_coordinates():
    """Against moves of the projected centre by a hundredth of a pixel, found by shifting the Gaussian."""
    geometry, model = circular(15, 20, views=1), some_gaussians(count=1, sigma=(2.0, 2.5))
    target = torch.from_numpy(np.random.default_rng(5).normal(size=(1, 3, 15, 20))).float()
    shape = (model.log_scales(UNITS), model.quaternions, model.coefficients(UNITS))

    def loss(centres):
        return (line_integrals(centres, *shape, geometry, "exact") * target).sum()

    centres = model.centres.clone().requires_grad_()
    loss(centres).backward()
    gradient = centres.grad
    assert gradient is not None
    origin, first, column, row = torch.from_numpy(geometry.ray_frames()[0]).float()
    depth = torch.linalg.solve(torch.stack([column, row, first], -1), (model.centres - origin).mT)[2]
    slopes = []
    for step, pixels in ((column, 20), (row, 15)):
        ends = [float(loss(model.centres + sign * 0.01 * depth * step)) for sign in (-1, 1)]
        slopes.append((ends[1] - ends[0]) / 0.02 * pixels / 2)
    panel_gradient = detector_gradient(model.centres, gradient, geometry)
    assert float(panel_gradient[0]) == pytest.approx(float(np.hypot(*slopes)), rel=5e-3)


def test_every_component_is_described():
    assert all(text for text in COMPONENTS.values())
