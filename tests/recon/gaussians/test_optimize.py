import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.optimize import nnls
from support.gaussian_scenes import PIXEL, circular, small_model, small_scan, spectral_model

from phantomgen.geometry.orbits import helical, spread_angles
from phantomgen.geometry.panel import Panel
from recon.data.view_subsets import count_complete_sets
from recon.gaussians import optimize
from recon.gaussians.adam import Adam
from recon.gaussians.likelihood import likelihood
from recon.gaussians.optimize import _diverges, _nearest_non_negative, _shorten_after_rise, _subsets, fit
from recon.gaussians.recipe import Recipe, Stage
from recon.gaussians.state import FitState
from spectra.errors import InputError
from spectra.threads import set_threads

PARTS = ("centres", "log_scales", "quaternions", "coefficients")
GEOMETRY = circular(16, 16, views=9)
RECIPE = Recipe(stages=(Stage(1.0, 4.0),), dispersion=0.01)


@pytest.fixture(scope="module")
def problem():
    """A scan of fifty Gaussians with noise, and a start that knows them badly."""
    truth = small_model(1, count=50)
    rng = np.random.default_rng(2)
    shift = torch.from_numpy(rng.normal(scale=0.3, size=(50, 3))).float()
    start = replace(truth, centres=truth.centres + shift, coefficients=truth.coefficients.mean().expand(50, 3).clone())
    return start, small_scan(truth, GEOMETRY, spectral_model(3), seed=3)


def run(problem, recipe=RECIPE):
    history = []
    fitted = fit(*problem, PIXEL, recipe, lambda p: history.append((p.deviance, p.gaussians.coefficients.min().item())))
    return fitted, np.array(history)


def test_the_deviance_falls_and_coefficients_stay_non_negative(problem):
    fitted, history = run(problem, replace(RECIPE, stages=(Stage(1.0, 15.0),)))
    deviance, lowest = history.T
    assert deviance[:3].mean() > 30
    assert deviance[-3:].mean() < 2.5
    assert (lowest >= 0).all()
    assert all(torch.isfinite(getattr(fitted, name)).all() for name in PARTS)


def test_steps_are_stable_where_few_views_see_a_gaussian():
    """A short helix whose three rows see each Gaussian in a few of the views; these sent coefficients to 30 times."""
    truth = small_model(1, count=50)
    helix = helical(60.0, 100.0, spread_angles(48, 0), 12.0, Panel(3, 16, 1.35), -6.0)
    scan = small_scan(truth, helix, spectral_model(3), seed=3)
    start = replace(truth, coefficients=truth.coefficients.mean().expand(50, 3).clone())
    fitted, history = run((start, scan), replace(RECIPE, stages=(Stage(1.0, 15.0),)))
    assert history[:, 0].max() < 200
    assert history[-8:, 0].mean() < 1.5
    assert fitted.coefficients.max() < 2 * truth.coefficients.max()


@pytest.mark.parametrize("dispersion", [0.0, 0.02])
@pytest.mark.parametrize("weighted", [True, False])
def test_of_the_true_model_deviance_and_chi_square_are_one(problem, dispersion, weighted):
    scan = problem[1].weighted(dispersion) if weighted else problem[1]
    found = likelihood(small_model(1, count=50), scan, dispersion)
    spread = np.sqrt(2 / (scan.counts.size / 3))
    assert found.deviance == pytest.approx(1, abs=5 * spread)
    np.testing.assert_allclose(found.chi_square, 1, atol=5 * spread)


def test_any_number_of_threads_gives_the_same_bits(problem, monkeypatch):
    monkeypatch.setattr("recon.ops.rasterize.cpu_calls.CHUNK", 16)
    results = []
    try:
        for threads in (1, 2):
            set_threads(threads)
            results.append(run(problem)[0])
    finally:
        set_threads(None)
    for name in PARTS:
        assert torch.equal(*(getattr(result, name) for result in results))


def test_the_start_is_left_as_it_was(problem):
    before = problem[0].detached()
    run(problem, replace(RECIPE, stages=(Stage(1.0, 1.0),)))
    assert all(torch.equal(getattr(before, name), getattr(problem[0], name)) for name in PARTS)
    assert not problem[0].centres.requires_grad


def test_stages_follow_each_other_at_their_binning(problem):
    steps = []
    recipe = replace(RECIPE, stages=(Stage(2.0, 1.0), Stage(1.0, 1.0)), views_per_step=3)
    fit(*problem, PIXEL, recipe, lambda p: steps.append((p.step, p.steps)))
    assert steps == [(i + 1, 6) for i in range(6)]


@pytest.mark.parametrize("warm_up", [0.0, 1.0])
def test_steps_of_the_geometry_grow_to_their_length(problem, warm_up, monkeypatch):
    recipe = replace(RECIPE, warm_up=warm_up, final_rate=1.0)
    lengths = []
    monkeypatch.setattr(Adam, "step", lambda adam, rates, number, decays: lengths.append(rates[0]))
    fit(*problem, PIXEL, recipe)
    per_sweep = len(lengths) // 4
    growing = np.arange(1, per_sweep + 1) / per_sweep if warm_up else np.ones(per_sweep)
    wanted = recipe.centre_rate * PIXEL * np.concatenate([growing, np.ones(len(lengths) - per_sweep)])
    np.testing.assert_allclose(lengths, wanted)


@pytest.mark.parametrize(("views", "per_sweep"), [(9, 3), (75, 25), (10, 3), (1, 1), (7, 2)])
def test_a_sweep_uses_every_view_once(views, per_sweep):
    seen = np.concatenate(list(_subsets(np.zeros(views, int), per_sweep, per_sweep)))
    assert sorted(seen) == list(range(views))


@pytest.mark.parametrize(("views", "kinds"), [(90, 2), (9, 3), (40, 4), (11, 2)])
def test_every_step_sees_every_kind_of_view(views, kinds):
    """One of two voltages alone cannot tell two bases apart, and a step that follows it leads astray."""
    kind = np.arange(views) % kinds
    for step in _subsets(kind, count_complete_sets(kind), 2 * count_complete_sets(kind)):
        assert set(kind[step]) == set(range(kinds))


def test_a_sweep_that_is_worse_than_the_last_shortens_steps_and_drops_momentum():
    state = FitState.begin(small_model(1))
    for deviance, factor in ((5.0, 1.0), (5.2, 1.0), (6.0, 0.5), (3.0, 0.5), (9.0, 0.25)):
        state.velocity += 1
        _shorten_after_rise(state, deviance, False, RECIPE.optimizer)
        assert bool(state.velocity.any())
        _shorten_after_rise(state, deviance, True, RECIPE.optimizer)
        assert state.step_factor == factor
    assert not state.velocity.any()
    again = FitState.restore(state.tensors(), json.loads(json.dumps(state.numbers())))
    assert (again.step_factor, again.last_sweep_deviance) == (0.25, 18.0)


@pytest.mark.parametrize(
    ("deviances", "diverges"),
    [
        ([47.0, 17, 40, 16, 14, 15, 92, 14, 34, 25, 40, 13], False),  # views of a helix
        ([2.0] * 30, False),
        ([0.0, 0.0, 0.0], False),
        ([2.0] * 5 + [442.0] + [2.0] * 5, False),  # one view
        ([2.0, 30, 3e3, 4e5, 5e6, 4e6], True),
        (list(2.0 * 1.2 ** np.arange(60)), True),
        ([2.0, 2.0, np.nan], True),
        ([2.0, 2.0, np.inf], True),
    ],
)
def test_a_deviance_that_grows_and_stays_large_is_a_divergence(deviances, diverges):
    state, found = FitState.begin(small_model(1)), False
    for deviance in deviances:
        found = found or _diverges(state, float(deviance), RECIPE.optimizer)
        state.done += 1
    assert found is diverges


def test_a_fit_that_diverges_begins_anew_with_more_views_per_step(problem, monkeypatch):
    """The second attempt is a fit with so many views and slower steps, and can be interrupted."""
    slower = RECIPE.optimizer.slower * RECIPE.coefficient_rate
    expected, _ = run(problem, replace(RECIPE, views_per_step=4, coefficient_rate=slower))
    monkeypatch.setattr(optimize, "_diverges", lambda state, *_: state.more_views == 1 and state.done == 5)
    seen, kept = [], []

    def on_step(progress):
        seen.append((progress.step, progress.steps))
        if progress.state.more_views == 4 and progress.step == 3:
            tensors = {name: value.clone() for name, value in progress.state.tensors().items()}
            kept.append((tensors, json.loads(json.dumps(progress.state.numbers()))))

    fitted = fit(*problem, PIXEL, RECIPE, on_step)
    many, few = sum(RECIPE.steps(9)), sum(replace(RECIPE, views_per_step=4).steps(9))
    assert seen == [(k + 1, many) for k in range(5)] + [(k + 1, few) for k in range(few)]
    again = fit(FitState.restore(*kept[0]), problem[1], PIXEL, RECIPE)
    for name in PARTS:
        assert torch.equal(getattr(fitted, name), getattr(expected, name))
        assert torch.equal(getattr(again, name), getattr(expected, name))


def test_a_state_of_an_older_version_lacks_what_it_did_not_know():
    state = FitState.begin(small_model(1))
    state.level, state.lowest_level, state.done = 2.0, 1.0, 7
    numbers = state.numbers()
    for name in ("level", "lowest_level", "more_views"):
        del numbers[name]
    again = FitState.restore(state.tensors(), numbers)
    assert (again.done, again.lowest_level, again.more_views) == (7, np.inf, 1)
    assert not any(_diverges(again, 47.0, RECIPE.optimizer) for _ in range(50))


def test_steps_that_always_diverge_end_with_all_views_per_step(problem, monkeypatch):
    monkeypatch.setattr(optimize, "_diverges", lambda *_: True)
    fitted, history = run(problem)
    assert len(history) == 0
    assert torch.equal(fitted.coefficients, problem[0].coefficients)


@pytest.mark.parametrize("name", ["views_per_step", "spacing", "coefficient_rate", "curvature_sweeps"])
def test_a_recipe_refuses_what_is_not_positive(name):
    with pytest.raises(InputError, match=f"recipe {name} must be positive, got 0"):
        Recipe(**{name: 0})


def test_a_recipe_needs_a_stage():
    with pytest.raises(InputError, match="at least one stage"):
        Recipe(stages=())


def test_curvature_may_be_renewed_more_often_than_once_a_sweep(problem):
    fitted, _ = run(problem, replace(RECIPE, stages=(Stage(1.0, 1.0),), curvature_sweeps=0.1))
    assert torch.isfinite(fitted.coefficients).all()


@pytest.mark.parametrize("bases", [1, 2, 3, 4])
def test_steps_end_at_the_nearest_non_negative_coefficients(bases):
    """Nearest in the metric of the likelihood: the same as non-negative least squares."""
    rng = np.random.default_rng(bases)
    roots = np.triu(rng.normal(size=(100, bases, bases)), 1) + np.eye(bases) * rng.uniform(0.3, 2, (100, 1, bases))
    inverse = np.linalg.inv(np.einsum("gim,gin->gmn", roots, roots)).astype(np.float32)
    wanted = rng.normal(size=(100, bases)).astype(np.float32)
    found = _nearest_non_negative(torch.tensor(wanted), torch.tensor(inverse))
    halves = np.linalg.cholesky(np.linalg.inv(inverse.astype(float))).transpose(0, 2, 1)
    exact = [nnls(half, half @ values)[0] for half, values in zip(halves, wanted.astype(float), strict=True)]
    np.testing.assert_allclose(found, exact, atol=1e-6 * np.abs(exact).max())
