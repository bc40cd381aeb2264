"""The fit: Gaussians follow the gradient of the likelihood of the counts, all channels at once.

Two kinds of unknowns, two kinds of steps. Given the geometry the model is linear in the coefficients up to the
exponential of Beer's law, so they take second-order steps (`recon.curvature`) with momentum, projected on
what is physical: no negative coefficient in the raw basis. Centres, scales and rotations follow Adam.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from recon.curvature import coefficient_curvature
from recon.gaussians import Gaussians
from recon.losses import deviance
from recon.measurements import Measurements, matching_bin
from recon.recipe import Recipe
from spectra.ops.transmit import transmit
from spectra.threads import without_other_pools

GEOMETRY = ("centres", "log_scales", "quaternions")


@dataclass(frozen=True)
class Progress:
    """What a callback is told after every step."""

    step: int
    steps: int
    seconds: float
    deviance: float
    gaussians: Gaussians


@without_other_pools()
def fit(
    start: Gaussians,
    measurements: Measurements,
    voxel: float,
    recipe: Recipe,
    on_step: Callable[[Progress], None] = lambda progress: None,
) -> Gaussians:
    """Improve Gaussians until the recipe's sweeps are used up.

    Parameters
    ----------
    start : first guess, for instance from `recon.initialize.initialize`
    measurements : training views, unbinned
    voxel : edge of a voxel of the reconstruction grid [mm]
    recipe : hyper-parameters
    on_step : called after every step

    Returns
    -------
    The fitted Gaussians; the thread count does not enter.
    """
    gaussians = start.detached()
    geometry = [getattr(gaussians, name).requires_grad_() for name in GEOMETRY]
    coefficients = gaussians.coefficients.requires_grad_()
    rates = [recipe.centre_rate * voxel, recipe.shape_rate, recipe.shape_rate]
    groups = [{"params": [p], "lr": r} for p, r in zip(geometry, rates, strict=True)]
    adam = torch.optim.Adam(groups, betas=(0.9, 0.99), eps=1e-15)
    velocity = torch.zeros_like(coefficients)
    began = time.perf_counter()
    steps = sum(_steps(len(measurements), recipe))
    done = 0
    for stage, length in zip(recipe.stages, _steps(len(measurements), recipe), strict=True):
        data = measurements.binned(matching_bin(measurements.geometry, stage.pixel * voxel))
        per_sweep = max(len(data) // recipe.views_per_step, 1)
        inverse = torch.empty(0)
        for step, views in enumerate(_subsets(len(data), per_sweep, length)):
            if step % max(round(recipe.curvature_sweeps * per_sweep), 1) == 0:
                inverse = _inverse_curvature(gaussians, data, recipe)
            fraction = done / steps
            warm = done < recipe.warm_up * per_sweep
            for group, rate in zip(adam.param_groups, rates, strict=True):
                group["lr"] = 0.0 if warm else rate * recipe.final_rate**fraction
            adam.zero_grad()
            coefficients.grad = None
            loss = _mean_deviance(gaussians, data[views], recipe.dispersion)
            loss.backward()
            adam.step()
            counts = np.prod(data.counts.shape)  # from the mean deviance of a few views to the likelihood of all
            pull = torch.einsum("gmn,gn->gm", inverse, coefficients.grad) * float(counts / 2)
            rate = recipe.coefficient_rate * min(1.0, 10 ** (1 - 2 * fraction))
            _project_step(coefficients, velocity, pull, inverse, rate, recipe.momentum)
            done += 1
            seconds = time.perf_counter() - began
            on_step(Progress(done, steps, seconds, loss.item(), gaussians))
    return gaussians.detached()


def _steps(views: int, recipe: Recipe) -> list[int]:
    """Steps of each stage."""
    per_sweep = max(views // recipe.views_per_step, 1)
    return [max(round(stage.sweeps * per_sweep), 1) for stage in recipe.stages]


def _subsets(views: int, per_sweep: int, steps: int) -> Iterator[np.ndarray]:
    """Evenly spread subsets of the views, one after the other in an order that jumps around the orbit."""
    stride = next(s for s in range(max(int(0.38 * per_sweep), 1), per_sweep + 1) if np.gcd(s, per_sweep) == 1)
    for step in range(steps):
        yield np.arange(step * stride % per_sweep, views, per_sweep)


def _mean_deviance(gaussians: Gaussians, data: Measurements, dispersion: float) -> Tensor:
    images = gaussians.line_integrals(data.geometry)
    gains = torch.from_numpy(data.gains * data.exposure[:, :, None, None].astype(np.float32))
    lengths = images.movedim(1, -1).contiguous()
    if data.profile is not None:
        known = torch.from_numpy(data.profile).to(lengths).movedim(0, -1)
        lengths = torch.cat([lengths, known.expand(len(lengths), *known.shape)], dim=-1)
    expected = transmit(lengths, data.transmission).movedim(-1, 1) * gains
    return deviance(torch.from_numpy(data.counts), expected, dispersion).mean()


def _inverse_curvature(gaussians: Gaussians, data: Measurements, recipe: Recipe) -> Tensor:
    """Inverse blocks of the coefficients' curvature, from a fifth of the views."""
    some = data[np.arange(0, len(data), 5)]
    blocks = coefficient_curvature(gaussians, some, recipe.dispersion) * (len(data) / len(some))
    diagonal = torch.diagonal(blocks, dim1=1, dim2=2)
    floor = 1e-4 * diagonal + 1e-6 * diagonal.mean(dim=0).clamp_min(1)  # a Gaussian that no ray meets stays as it is
    return torch.linalg.inv(blocks + torch.diag_embed(floor))


@torch.no_grad()
def _project_step(
    coefficients: Tensor, velocity: Tensor, pull: Tensor, inverse: Tensor, rate: float, momentum: float
) -> None:
    """Heavy-ball step, in place, that ends at non-negative coefficients."""
    moved = coefficients + momentum * velocity - (1 - momentum) * rate * pull
    moved = _nearest_non_negative(moved, inverse)
    velocity.copy_(moved - coefficients)
    coefficients.copy_(moved)


def _nearest_non_negative(
    wanted: Float[Tensor, "gaussian basis"], inverse: Float[Tensor, "gaussian basis basis"]
) -> Float[Tensor, "gaussian basis"]:
    """Non-negative coefficients nearest to those wanted, in the metric whose inverse is given.

    Setting the negative ones to 0 would leave the others where they stood against them: with water and bone as bases,
    bone that wants to be negative in water would hold too much water up. So the others follow. Those that become
    negative in turn are held at 0, those that are pulled up are let go (block principal pivoting).
    """
    free = wanted >= 0
    nearest = wanted
    for _ in range(wanted.shape[1]):
        held = (~free).to(wanted)
        system = inverse * held[:, :, None] * held[:, None, :] + torch.diag_embed(free.to(wanted))
        pull = torch.linalg.solve(system, held * wanted)
        nearest = wanted - torch.einsum("gmn,gn->gm", inverse, pull)
        free = torch.where(free, nearest >= 0, pull > 0)
    return nearest.clamp(min=0)
