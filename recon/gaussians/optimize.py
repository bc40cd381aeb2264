"""The fit: Gaussians follow the gradient of the likelihood of the counts, all channels at once.

Two kinds of unknowns, two kinds of steps. Given the geometry the model is linear in the coefficients up to the
exponential of Beer's law, so they take second-order steps (`recon.gaussians.fisher`) with momentum, projected on
what is physical: no negative coefficient in the raw basis. Centres, scales and rotations follow Adam.
What steps change is a `recon.gaussians.state.FitState`, so that a fit can be interrupted between any two of them.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import accumulate, islice

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from recon.data.array_store import IN_MEMORY, ArrayStore
from recon.data.measurements import Measurements, matching_bin
from recon.data.view_subsets import every, kinds_of, parts_of, rounds_of
from recon.gaussians.fisher import coefficient_curvature
from recon.gaussians.likelihood import Likelihood, likelihood, likelihood_and_gradients
from recon.gaussians.model import Gaussians
from recon.gaussians.processes import ALONE, Processes
from recon.gaussians.recipe import Recipe
from recon.gaussians.state import FitState
from recon.gaussians.voxel_prior import VoxelPrior
from recon.ops.nonnegative_newton import nonnegative_newton_step
from spectra.threads import without_other_pools

SNAPSHOTS = 10  # models kept along the way, for error against time
CURVATURE_VIEWS = 12  # at most, evenly spread, that curvature is computed from
HELD = 1e6  # times the curvature of a coefficient is added to it to hold it; others then move as if it were known
RISEN = 1.1  # times the deviance of the sweep before; a sweep with more calls for shorter steps of the coefficients
PATIENCE = 2  # snapshots in a row without progress on held-out rays that end a fit


@dataclass(frozen=True)
class Progress:
    """What a callback is told after every step.

    Parameters
    ----------
    step, steps : steps made, and all
    seconds : spent on steps
    deviance : of the step's rays, before the step, over what noise alone would leave; see `recon.ops.deviance`
    gaussians : the model after the step
    chi_square : of the step's rays per channel, before the step, over what noise alone would leave
    state : all that is needed to go on from here; None where a method cannot
    snapshot : whether this is one of the few steps along the way that are looked at more closely
    held_out : at snapshots, chi-square per channel of the rays that the fit does not see; None where there are none
    """

    step: int
    steps: int
    seconds: float
    deviance: float
    gaussians: Gaussians
    chi_square: Float[np.ndarray, " channel"]
    state: FitState | None
    snapshot: bool
    held_out: Float[np.ndarray, " channel"] | None = None


@without_other_pools()
def fit(
    start: Gaussians | FitState,
    measurements: Measurements,
    voxel: float,
    recipe: Recipe,
    on_step: Callable[[Progress], bool | None] = lambda progress: None,
    held_out: Measurements | None = None,
    processes: Processes = ALONE,
    anchor: VoxelPrior | None = None,
    store: ArrayStore = IN_MEMORY,
) -> Gaussians:
    """Improve Gaussians until the recipe's sweeps are used up.

    Parameters
    ----------
    start : first guess, for instance from `recon.gaussians.initial.initialize.initialize`, or where a fit was
        interrupted
    measurements : training views, unbinned
    voxel : edge of a voxel of the reconstruction grid [mm]
    recipe : hyper-parameters
    on_step : called after every step; the fit ends early where it returns True
    held_out : views that are not fitted; the fit ends when chi-square on them no longer falls
    processes : that share the views of each step; all must be given the same arguments
    anchor : volumes to stay near; None for the likelihood alone
    store : where large arrays live

    Returns
    -------
    The fitted Gaussians; the thread count does not enter.
    """
    state = start if isinstance(start, FitState) else FitState.begin(start)
    coefficients = state.gaussians.coefficients
    rates = np.array([recipe.centre_rate * voxel, recipe.shape_rate, recipe.shape_rate])
    began = time.perf_counter() - state.seconds
    kinds = kinds_of(measurements.exposure)
    rounds = rounds_of(kinds)  # a step takes a view of each kind: one kind alone cannot tell bases apart
    lengths = recipe.steps(rounds)
    steps, firsts = sum(lengths), accumulate(lengths, initial=0)
    for stage, first, length in zip(recipe.stages, firsts, lengths, strict=False):
        if state.done >= first + length:
            continue
        data = measurements.binned(matching_bin(measurements.geometry, stage.pixel * voxel))
        data = data.weighted(recipe.dispersion, store)
        per_sweep = recipe.per_sweep(rounds)
        for step, views in islice(enumerate(_subsets(kinds, per_sweep, length)), state.done - first, None):
            if step % recipe.curvature_steps(rounds) == 0:
                state.inverse, state.weight = _inverse_curvature(state.gaussians, data, recipe, processes, anchor)
            fraction = state.done / steps
            ramp = min(1.0, (state.done + 1) / max(recipe.warm_up * per_sweep, 1.0))
            found = likelihood_and_gradients(state.gaussians, data, views, recipe.dispersion, processes)
            scale = float(np.prod(data.counts.shape)) / 2  # from a mean deviance to the likelihood of all views
            if anchor is not None:
                anchor.add_gradients(state.gaussians, state.weight / scale, state.done)
            state.adam.step(rates * ramp * recipe.final_rate**fraction, state.done + 1)
            newton_step = torch.einsum("gmn,gn->gm", state.inverse, coefficients.grad) * scale
            rate = state.restraint * recipe.coefficient_rate * min(1.0, 10 ** (1 - 2 * fraction))
            _project_step(coefficients, state.velocity, newton_step, state.inverse, rate, recipe.momentum)
            _restrain(state, found.deviance, (step + 1) % per_sweep == 0)
            state.done += 1
            snapshot = state.done % max(steps // SNAPSHOTS, 1) == 0 or state.done == steps
            unseen = _judge(state, held_out, recipe, processes) if snapshot and held_out is not None else None
            state.seconds = time.perf_counter() - began
            progress = _progress(state, steps, found, snapshot, unseen)
            if processes.any(bool(on_step(progress))) or state.unimproved >= PATIENCE:
                return state.gaussians.detached()
    return state.gaussians.detached()


def _restrain(state: FitState, deviance: float, swept: bool) -> None:
    """Halve the steps of the coefficients, and drop their momentum, after a sweep that was worse than the one before.

    Gradients of few views at a time may let momentum grow: with 13 views, twenty sweeps led a deviance of 21 to 12,000.
    """
    state.sweep += deviance
    if not swept:
        return
    if state.sweep > RISEN * state.last_sweep:
        state.restraint *= 0.5
        state.velocity.zero_()
    state.last_sweep, state.sweep = state.sweep, 0.0


def _progress(state: FitState, steps: int, found: Likelihood, snapshot: bool, unseen: Likelihood | None) -> Progress:
    held_out = None if unseen is None else unseen.chi_square
    return Progress(
        state.done, steps, state.seconds, found.deviance, state.gaussians, found.chi_square, state, snapshot, held_out
    )  # fmt: skip


def _judge(state: FitState, held_out: Measurements, recipe: Recipe, processes: Processes) -> Likelihood:
    """Likelihood with held-out rays; the state remembers the best."""
    found = likelihood(state.gaussians, held_out, recipe.dispersion, processes)
    mean = float(np.nanmean(found.chi_square))
    better = mean < state.lowest
    state.lowest, state.unimproved = min(mean, state.lowest), 0 if better else state.unimproved + 1
    return found


def _subsets(kinds: Int[np.ndarray, " view"], per_sweep: int, steps: int) -> Iterator[np.ndarray]:
    """Evenly spread subsets of the views, one after the other in an order that jumps around the orbit."""
    parts = parts_of(kinds, per_sweep)
    stride = next(s for s in range(max(int(0.38 * per_sweep), 1), per_sweep + 1) if np.gcd(s, per_sweep) == 1)
    for step in range(steps):
        yield parts[step * stride % per_sweep]


def _inverse_curvature(
    gaussians: Gaussians, data: Measurements, recipe: Recipe, processes: Processes, anchor: VoxelPrior | None
) -> tuple[Tensor, Tensor]:
    """Inverse blocks of the coefficients' curvature, from some of the views, and the weight of the prior."""
    some = every(kinds_of(data.exposure), -(-len(data) // CURVATURE_VIEWS))
    blocks = coefficient_curvature(gaussians, data[processes.share(some)], recipe.dispersion)
    processes.add_up([blocks])
    blocks, weight = blocks * (len(data) / len(some)), torch.empty(0)
    if anchor is not None:
        blocks, weight = anchor.curvature(gaussians, blocks)
    diagonal = torch.diagonal(blocks, dim1=1, dim2=2)
    floor = 1e-4 * diagonal + 1e-6 * diagonal.mean(dim=0).clamp_min(1)  # a Gaussian that no ray meets stays as it is
    held = None if anchor is None else anchor.agents_in_metal(gaussians)
    if held is not None:
        floor = floor + HELD * held * diagonal
    return torch.linalg.inv(blocks + torch.diag_embed(floor)), weight


@torch.no_grad()
def _project_step(
    coefficients: Tensor, velocity: Tensor, newton_step: Tensor, inverse: Tensor, rate: float, momentum: float
) -> None:
    """Heavy-ball step, in place, that ends at non-negative coefficients."""
    moved = coefficients + momentum * velocity - (1 - momentum) * rate * newton_step
    outside = (moved < 0).any(dim=1)
    moved[outside] = _nearest_non_negative(moved[outside], inverse[outside])
    velocity.copy_(moved - coefficients)
    coefficients.copy_(moved)


def _nearest_non_negative(
    wanted: Float[Tensor, "gaussian basis"], inverse: Float[Tensor, "gaussian basis basis"]
) -> Float[Tensor, "gaussian basis"]:
    """Non-negative coefficients nearest to those wanted, in the metric whose inverse is given.

    Setting the negative ones to 0 would leave the others where they stood against them: with water and bone as bases,
    bone that wants to be negative in water would hold too much water up. So the others follow.
    """
    rows, columns = np.triu_indices(wanted.shape[1])
    volumes, blocks = wanted.T.cpu().numpy(), inverse[:, rows, columns].T.cpu().numpy()
    return torch.from_numpy(nonnegative_newton_step(volumes, blocks, np.zeros_like(volumes))).T.to(wanted)
