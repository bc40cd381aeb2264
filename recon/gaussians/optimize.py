"""The steps of the fit, which lower the objective for all channels at once.

`recon.gaussians.objective` has the equation. It has two groups of unknowns, and each has its own kind of step. With the
geometry held, the model is linear in the coefficients up to the exponential of Beer's law, so these take second-order
steps (`recon.gaussians.fisher`) with momentum, projected onto non-negative coefficients. Centres, scales and rotations
take steps of Adam. What steps change is a `recon.gaussians.state.FitState`, so that a fit can be interrupted between
any two of them.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import accumulate, islice
from math import inf, isfinite, log, sqrt

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from recon.data.measurements import Measurements, matching_bin
from recon.data.view_subsets import count_complete_sets, golden_section_order, interleaved_subsets, view_groups
from recon.gaussians.likelihood import Likelihood, likelihood
from recon.gaussians.model import GaussianModel
from recon.gaussians.objective import Objective, seen_gaussians
from recon.gaussians.processes import LOCAL, Processes, Resources
from recon.gaussians.recipe import Recipe
from recon.gaussians.settings import OptimizerSettings
from recon.gaussians.state import FitState
from recon.gaussians.voxel_prior import VoxelPrior
from recon.ops.nonnegative_newton import nonnegative_newton_step
from spectra.threads import without_other_pools

TINY = 1e-30  # deviance; smaller ones count as this, as 0 has no logarithm
SNAPSHOTS = 10  # models kept along the way, for error against time; with held-out views, looks at them


@dataclass(frozen=True)
class Progress:
    """What a callback gets after every step.

    Parameters
    ----------
    step, steps : number of steps made, and of all steps
    seconds : time spent on steps [s]
    deviance : deviance of the step's views before the step, over its expected value; see `recon.ops.deviance`
    gaussians : the model after the step
    chi_square : chi-square of the step's views per channel before the step, (C,), over its expected value
    state : all that is needed to go on from here; None for a method that cannot
    snapshot : whether this is one of the `SNAPSHOTS` steps whose model is kept
    held_out : at snapshots, chi-square per channel of the held-out views, (C,); None where there are none
    """

    step: int
    steps: int
    seconds: float
    deviance: float
    gaussians: GaussianModel
    chi_square: Float[np.ndarray, " channel"]
    state: FitState | None
    snapshot: bool
    held_out: Float[np.ndarray, " channel"] | None = None


OnStep = Callable[[Progress], bool | None]


@without_other_pools()
def fit(
    start: GaussianModel | FitState,
    measurements: Measurements,
    voxel: float,
    recipe: Recipe,
    on_step: OnStep = lambda progress: None,
    held_out: Measurements | None = None,
    prior: VoxelPrior | None = None,
    resources: Resources = LOCAL,
) -> GaussianModel:
    """Fit Gaussians until the recipe's sweeps are used up; begin anew with more views per step where steps diverge.

    Parameters
    ----------
    start : first guess, for instance from `recon.gaussians.initial.initialize.initialize`, or the state of an
        interrupted fit
    measurements : training views, unbinned
    voxel : edge of a voxel of the reconstruction grid [mm]
    recipe : settings
    on_step : called after every step; the fit ends early where it returns True
    held_out : views that are not fitted; the fit ends when chi-square on them no longer falls
    prior : the voxel prior; None for the data term alone
    resources : processes that share the views, and where arrays are kept; the device is that of `start`

    Returns
    -------
    The fitted Gaussians; any number of threads gives the same bits.
    """
    state = start if isinstance(start, FitState) else FitState.begin(start)
    began = time.perf_counter() - state.seconds
    seen = seen_gaussians(state.initial, measurements.geometry)
    while True:
        wider = replace(recipe, views_per_step=recipe.views_per_step * state.more_views)
        if state.more_views > 1:
            wider = replace(wider, coefficient_rate=recipe.coefficient_rate * recipe.optimizer.slower)
        steps = _Steps(measurements, voxel, wider, prior, resources, seen, held_out, began)
        if not steps.run(state, on_step):
            return state.gaussians.detached()
        if wider.per_sweep(count_complete_sets(view_groups(measurements.exposure))) == 1:  # none is left to try
            return state.gaussians.detached()
        state = replace(FitState.begin(state.initial), more_views=state.more_views * recipe.optimizer.more_views)


@dataclass(frozen=True, eq=False)
class _Steps:
    """All steps of a fit, with one number of views per step; parameters as those of `fit`."""

    measurements: Measurements
    voxel: float
    recipe: Recipe
    prior: VoxelPrior | None
    resources: Resources
    seen: Bool[np.ndarray, "view gaussian"] | None
    held_out: Measurements | None
    began: float

    def run(self, state: FitState, on_step: OnStep) -> bool:
        """Change a state by all steps that it has not made, until a callback or held-out views end the fit.

        Parameters
        ----------
        state : where the fit stands
        on_step : called after every step

        Returns
        -------
        whether the steps diverged, and the fit ended for that
        """
        recipe, settings, processes = self.recipe, self.recipe.optimizer, self.resources.processes
        groups = view_groups(self.measurements.exposure)
        complete_sets = count_complete_sets(groups)  # a step uses views of all groups: one cannot separate the bases
        lengths, per_sweep = recipe.steps(complete_sets), recipe.per_sweep(complete_sets)
        steps, firsts = sum(lengths), accumulate(lengths, initial=0)
        for stage, first, length in zip(recipe.stages, firsts, lengths, strict=False):
            if state.done >= first + length:
                continue
            data = self.measurements.binned(matching_bin(self.measurements.geometry, stage.pixel * self.voxel))
            weighted = data.weighted(recipe.dispersion, self.resources.store)
            objective = Objective(weighted, recipe.dispersion, self.prior, processes, self.seen)
            for step, views in islice(enumerate(_subsets(groups, per_sweep, length)), state.done - first, None):
                if step % recipe.curvature_steps(complete_sets) == 0:
                    state.inverse_curvature, state.prior_metric = objective.curvature(state.gaussians, settings)
                found = objective.set_gradients(state.gaussians, views, state.prior_metric, state.done)
                if _diverges(state, found.deviance, settings):
                    return True
                _move_geometry(state, recipe, self.voxel, per_sweep, steps)
                _move_coefficients(state, recipe, objective.scale, steps)
                _shorten_after_rise(state, found.deviance, (step + 1) % per_sweep == 0, settings)
                state.done += 1
                snapshot = state.done % max(steps // SNAPSHOTS, 1) == 0 or state.done == steps
                unseen = (
                    _held_out_likelihood(state, self.held_out, recipe, processes)
                    if snapshot and self.held_out is not None
                    else None
                )
                state.seconds = time.perf_counter() - self.began
                progress = _progress(state, steps, found, snapshot, unseen)
                if processes.any(bool(on_step(progress))) or _has_stopped_improving(state, settings):
                    return False
        return False


def _diverges(state: FitState, deviance: float, settings: OptimizerSettings) -> bool:
    """Say whether the deviance of the steps has grown so much that steps of more views are needed.

    Noise of few views in directions that the channels hardly determine may lead so far that the curvature no longer
    holds: with six bases and one view per step, twenty steps led from a deviance of 2 to 4,000,000.
    """
    level = log(max(deviance, TINY)) if isfinite(deviance) else inf
    state.level = level if state.lowest_level == inf else state.level + (level - state.level) / settings.recent
    state.lowest_level = min(state.level, state.lowest_level)
    return not state.level - state.lowest_level < log(settings.divergence)


def _move_geometry(state: FitState, recipe: Recipe, voxel: float, per_sweep: int, steps: int) -> None:
    """Make a step of Adam in centres, scales and rotations, whose length grows at first and then falls.

    Errors of steps of few views add up like those of a random walk: many steps per sweep are shorter, so that a sweep
    leads as far. Otherwise coefficients diverged in a helix of 384 views.
    """
    of_arrays: dict[str, float] = dict.fromkeys(("log_scales", "quaternions"), recipe.shape_rate)
    names = state.gaussians.GEOMETRY
    lengths = np.array([of_arrays.get(name, recipe.centre_rate * voxel) for name in names])
    ramp = min(1.0, (state.done + 1) / max(recipe.warm_up * per_sweep, 1.0))
    decays = recipe.optimizer.gradient_decay, recipe.optimizer.square_decay
    ramp *= min(1.0, sqrt(recipe.few_views / per_sweep))
    state.adam.step(lengths * ramp * recipe.final_rate ** (state.done / steps), state.done + 1, decays)
    if state.gaussians.SIGNED:  # a Gaussian of either sign may grow beyond all the others that make up for it
        with torch.no_grad():
            widest = state.initial.log_scales.amax(dim=1, keepdim=True) + log(recipe.volume_fit.widest)
            state.gaussians.log_scales.copy_(torch.minimum(state.gaussians.log_scales, widest))


def _move_coefficients(state: FitState, recipe: Recipe, scale: float, steps: int) -> None:
    """Make a step of Newton's method with momentum in the coefficients, whose length falls towards the end."""
    settings, coefficients = recipe.optimizer, state.gaussians.coefficients
    newton_step = torch.einsum("...mn,...n->...m", state.inverse_curvature, coefficients.grad) * scale
    fall = (1 / settings.coefficient_final) ** (1 - state.done / steps / settings.coefficient_full)
    rate = state.step_factor * recipe.coefficient_rate * min(1.0, fall)
    _project_step(
        coefficients,
        state.velocity,
        newton_step,
        state.inverse_curvature,
        rate,
        recipe.momentum,
        state.gaussians.SIGNED,
    )


def _shorten_after_rise(state: FitState, deviance: float, swept: bool, settings: OptimizerSettings) -> None:
    """Shorten the steps of the coefficients, and drop their momentum, after a sweep that raised the deviance.

    Gradients of few views may let momentum grow: with 13 views, twenty sweeps led from a deviance of 21 to 12,000.
    """
    state.sweep_deviance += deviance
    if not swept:
        return
    if state.sweep_deviance > settings.rise * state.last_sweep_deviance:
        state.step_factor *= settings.shortening
        state.velocity.zero_()
    state.last_sweep_deviance, state.sweep_deviance = state.sweep_deviance, 0.0


def _progress(state: FitState, steps: int, found: Likelihood, snapshot: bool, unseen: Likelihood | None) -> Progress:
    held_out = None if unseen is None else unseen.chi_square
    return Progress(
        state.done, steps, state.seconds, found.deviance, state.gaussians, found.chi_square, state, snapshot, held_out
    )  # fmt: skip


def _held_out_likelihood(state: FitState, held_out: Measurements, recipe: Recipe, processes: Processes) -> Likelihood:
    """Compute the likelihood of held-out views, and keep the smallest chi-square in the state."""
    found = likelihood(state.gaussians, held_out, recipe.dispersion, processes)
    mean = float(np.nanmean(found.chi_square))
    better = mean < state.lowest
    state.lowest, state.unimproved = min(mean, state.lowest), 0 if better else state.unimproved + 1
    return found


def _has_stopped_improving(state: FitState, settings: OptimizerSettings) -> bool:
    """Stopping rule: chi-square of the held-out views was not a new minimum `settings.patience` times in a row.

    Without held-out views it never applies, and a fit ends after the sweeps of its recipe.
    """
    return state.unimproved >= settings.patience


def _subsets(groups: Int[np.ndarray, " view"], per_sweep: int, steps: int) -> Iterator[np.ndarray]:
    """Yield evenly spread subsets of the views, in an order in which neighbours are far apart on the orbit."""
    parts = interleaved_subsets(groups, per_sweep)
    order = golden_section_order(per_sweep)
    for step in range(steps):
        yield parts[order[step % per_sweep]]


@torch.no_grad()
def _project_step(
    coefficients: Tensor,
    velocity: Tensor,
    newton_step: Tensor,
    inverse: Tensor,
    rate: float,
    momentum: float,
    signed: bool,
) -> None:
    """Make a heavy-ball step, in place, that ends at non-negative coefficients where they have no sign."""
    moved = coefficients + momentum * velocity - (1 - momentum) * rate * newton_step
    if not signed:
        outside = (moved < 0).any(dim=-1)
        moved[outside] = _nearest_non_negative(moved[outside], inverse[outside])
    velocity.copy_(moved - coefficients)
    coefficients.copy_(moved)


def _nearest_non_negative(
    wanted: Float[Tensor, "gaussian basis"], inverse: Float[Tensor, "gaussian basis basis"]
) -> Float[Tensor, "gaussian basis"]:
    """Find the non-negative coefficients nearest to those wanted, in the metric whose inverse is given.

    Setting negative ones to 0 alone would leave the others too large: with water and bone as bases, bone that would be
    negative in water would leave too much water. So the others change with them.
    """
    rows, columns = np.triu_indices(wanted.shape[1])
    volumes, blocks = wanted.T, inverse[:, rows, columns].T
    if wanted.device.type != "cpu":
        return nonnegative_newton_step(volumes, blocks, torch.zeros_like(volumes)).T.to(wanted)
    found = nonnegative_newton_step(volumes.numpy(), blocks.numpy(), np.zeros_like(volumes.numpy()))
    return torch.from_numpy(found).T.to(wanted)
