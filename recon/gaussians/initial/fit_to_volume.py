"""Gaussians that follow given volumes as closely as they can.

A least-squares problem without any rays: every evaluation voxelizes the model and the gradient of its distance from the
volumes, which costs a few per cent of a sweep over all views. It is solved by accelerated gradient steps (Nesterov
1983), divided by the diagonal of the curvature that single Gaussians would have, in a frame of each Gaussian's own;
momentum is dropped where it leads uphill (O'Donoghue & Candes 2015, doi:10.1007/s10208-013-9150-3). Limited-memory BFGS
wants two thirds of the evaluations on large models, but its path depends on the last digits: noise of 1e-6 in the
volumes, as much as the rounding of another processor, moved fits of small scans by up to 0.3 dB, and with these steps
by less than 0.1 dB. Coefficients stay non-negative: one at 0 that would sink further is held. So is the length of a
Gaussian at twice what it began with: a needle through even tissue hardly shows in voxels, while a view along it sees
all of what sticks out at its ends.

Means of voxels do not tell what lies within a voxel: a thin dense sheet in the middle of the last voxel before a face
meets them better than an even density whose edge leaks into the next voxel, but line integrals along the face differ by
7 to 10 %. So the distance on a second grid, half a voxel further along every axis, is added with a small weight.
"""

import math
from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from phantomgen.geometry.voxel_grid import Grid
from recon.gaussians.initial.local_frame import GEOMETRY, SCALES, gradient_of_steps, moved
from recon.gaussians.model import Gaussians
from recon.ops.voxelize import mass_within, voxelize_tensor
from recon.voxel.method import OnIteration, Report, unwatched

CUTOFF = 3.5  # standard deviations; with 3.1, what lies beyond makes the inside 0.2 to 0.5 % too low
HALFWAY_WEIGHT = 0.1  # of the distance on the grid half a voxel further; 0.3 and 1 blurred thin vessels
RENEWED = 5  # evaluations after which the diagonal is computed anew, which costs as much as an evaluation
REACH = (0.5, 0.3, 0.2)  # longest step of a coordinate [standard deviations], a log-scale and an angle [rad]
FIRST = 0.4  # length of the steps over those that the diagonal suggests
WORSE = 1.0005  # times the last distance; a step that leads further away is not taken,
SHORTER = 0.7  # and those after it are so many times as long
INERTIA = 0.9  # of the last step that goes into the next, at most
MANY = 20_000  # Gaussians; fewer take less time for an evaluation and get more evaluations,
MOST = 2.5  # but not more than so many times as many
WIDEST = 2.0  # a Gaussian's longest standard deviation over that at the start
PEAK = 0.999  # quantile of the positive values of a basis that its distance is measured in
FAINTEST = 0.01  # of the basis that shows most; one that shows less counts as if it showed as much


def fit_to_volume(
    start: Gaussians,
    volumes: Float[np.ndarray, "basis z y x"],
    grid: Grid,
    metric: Float[np.ndarray, "basis basis"],
    evaluations: int,
    on_evaluation: OnIteration = unwatched,
) -> Gaussians:
    """Bring Gaussians closer to volumes.

    Parameters
    ----------
    start : where to begin; their number stays
    volumes : to follow [1/mm]
    grid : of `volumes`
    metric : weighs differences of the bases, see `metric_of`
    evaluations : voxelizations to spend, each with its gradient, see `evaluations_for`
    on_evaluation : called after each; its residual is half the squared distance in the metric, whose trace counts as 1
    """
    problem = _Distance(torch.from_numpy(volumes).to(start.centres), metric, grid, Report(on_evaluation, evaluations))
    model, length, since = start.detached(), FIRST, 0
    widest = model.log_scales.amax(dim=1, keepdim=True) + math.log(WIDEST)
    distance, gradient = problem.evaluate(model)
    last, renewed = torch.zeros_like(gradient), -RENEWED
    while problem.evaluations < evaluations:
        if problem.evaluations >= renewed + RENEWED:
            problem.renew_diagonal(model)
            renewed = problem.evaluations
        if float((last * gradient).sum()) > 0:
            last, since = torch.zeros_like(last), 0
        held = _held(model, gradient, widest)
        wanted = min(INERTIA, since / (since + 3)) * last - length * problem.precondition(gradient.masked_fill(held, 0))
        step = _within_reach(wanted.masked_fill(held, 0), model, grid)
        ahead = _bounded(moved(model, step), widest)
        there, slope = problem.evaluate(ahead)
        if there > WORSE * distance:
            last, since, length = torch.zeros_like(last), 0, SHORTER * length
            continue
        step[:, SCALES] = ahead.log_scales - model.log_scales
        step[:, GEOMETRY:] = ahead.coefficients - model.coefficients
        model, distance, gradient, last, since = ahead, there, slope, step, since + 1
    return model


def evaluations_for(gaussians: int, asked: int) -> int:
    """Evaluations for so many Gaussians, where `asked` are meant for `MANY` and more.

    Far from the minimum the path depends on the last digits of the volumes, and so on the processor; near it, it does
    not. Few Gaussians reach the minimum in little time.
    """
    return round(asked * min(max(math.sqrt(MANY / max(gaussians, 1)), 1.0), MOST))


def metric_of(
    volumes: Float[np.ndarray, "basis z y x"], fisher: Float[np.ndarray, "basis basis"]
) -> Float[np.ndarray, "basis basis"]:
    """A metric in which distances of every basis count relative to its large values.

    That of the rays' information would let what Gaussians cannot follow in one basis be made up for by the others.

    Parameters
    ----------
    volumes : to follow [1/mm]
    fisher : mean Fisher matrix of the rays' line integrals, which tells what a faint basis shows

    Returns
    -------
    diagonal, 1 over the square of each basis' large values [mm^2]
    """
    peaks = np.array([np.quantile(v[v > 0], PEAK) if (v > 0).any() else 0.0 for v in volumes])
    precision = np.sqrt(np.diag(fisher))
    shown = np.maximum(peaks * precision, FAINTEST * (peaks * precision).max())
    return np.diag((precision / np.maximum(shown, 1e-30)) ** 2)


class _Distance:
    """Half the squared distance of a model from volumes, its gradient, and the diagonal of its curvature."""

    def __init__(
        self,
        volumes: Float[Tensor, "basis z y x"],
        metric: Float[np.ndarray, "basis basis"],
        grid: Grid,
        report: Report,
    ) -> None:
        self.grid = grid
        self.targets = [(grid, mass_within(CUTOFF) * volumes, 1.0)]
        if min(grid.shape) > 1:
            self.targets.append((_halfway(grid), mass_within(CUTOFF) * _means_halfway(volumes), HALFWAY_WEIGHT))
        self.metric = torch.from_numpy(metric / np.trace(metric)).to(volumes)
        self.inverse_metric = torch.linalg.inv(self.metric)
        self.evaluations, self.report = 0, report

    def evaluate(self, model: Gaussians) -> tuple[float, Float[Tensor, "gaussian step"]]:
        parts = [p.detach().requires_grad_() for p in _parts(model)]
        distance, shown, on_voxels = 0.0, torch.empty(0), 0.0
        for grid, target, weight in self.targets:
            found = voxelize_tensor(parts[0], parts[1], parts[2], parts[3], grid, cutoff=CUTOFF)
            away = found.detach() - target
            weighted = weight * torch.einsum("mn,nzyx->mzyx", self.metric, away)
            found.backward(weighted)
            # rows first: ten times as fast
            part = 0.5 * float((away * weighted).sum(dim=-1).sum(dtype=torch.float64))
            distance += part
            if grid == self.grid:
                shown, on_voxels = found.detach(), part
        self.evaluations += 1
        self.report(shown.cpu().numpy(), on_voxels, self.grid)
        return distance, gradient_of_steps(model, [p.grad for p in parts if p.grad is not None])

    def renew_diagonal(self, model: Gaussians) -> None:
        """Curvature along each step of a Gaussian that is alone, times how much others overlap it."""
        geometry, one = _parts(model)[:3], torch.ones_like(model.coefficients[:, :1]).requires_grad_()
        crowd = voxelize_tensor(*geometry, one, self.grid, cutoff=CUTOFF)
        crowd.backward(crowd.detach())
        assert one.grad is not None
        share = one.grad[:, 0]
        power = torch.einsum("gm,mn,gn->g", model.coefficients, self.metric, model.coefficients)
        energy = (share * (power + 0.01 * power.mean()))[:, None]
        variance, seen = torch.exp(2 * model.log_scales), _seen_variance(model, self.grid)
        own = variance / seen  # the rest is the voxel's
        left, right = seen.roll(-1, dims=1), seen.roll(-2, dims=1)
        bends = torch.cat(
            [
                0.5 / seen,
                (1 - own) ** 2 + (1 - own) * own + 0.75 * own**2,
                (left - right) ** 2 / (4 * left * right) + 0.01,
            ],
            dim=1,
        )
        self.bends = energy * bends + 1e-12
        self.share = share.clamp_min(1e-3)[:, None]

    def precondition(self, gradient: Float[Tensor, "gaussian step"]) -> Float[Tensor, "gaussian step"]:
        geometry = gradient[:, :GEOMETRY] / self.bends
        return torch.cat([geometry, gradient[:, GEOMETRY:] @ self.inverse_metric / self.share], dim=1)


def _halfway(grid: Grid) -> Grid:
    """Grid whose voxels are centred on the corners of the voxels of another one."""
    depth, height, width = (n + 1 for n in grid.shape)
    z, y, x = (o - s / 2 for o, s in zip(grid.origin, grid.spacing, strict=True))
    return Grid((depth, height, width), grid.spacing, (z, y, x))


def _means_halfway(volumes: Float[Tensor, "basis z y x"]) -> Float[Tensor, "basis z1 y1 x1"]:
    """Means over the voxels of `_halfway`; outside the grid the nearest voxel counts."""
    out = torch.nn.functional.pad(volumes[None], (1, 1, 1, 1, 1, 1), mode="replicate")[0]
    for axis in (1, 2, 3):
        before, after = out.narrow(axis, 0, out.shape[axis] - 1), out.narrow(axis, 1, out.shape[axis] - 1)
        out = 0.5 * (before + after)
    return out.contiguous()


def _parts(model: Gaussians) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    return model.centres, model.log_scales, model.quaternions, model.coefficients


def _seen_variance(model: Gaussians, grid: Grid) -> Float[Tensor, "gaussian 3"]:
    """Of a Gaussian averaged over voxels, along its axes [mm^2]."""
    return torch.exp(2 * model.log_scales) + min(grid.spacing) ** 2 / 12


def _bounded(model: Gaussians, widest: Float[Tensor, "gaussian 1"]) -> Gaussians:
    """Gaussians none of whose log-scales is above the widest."""
    return replace(model, log_scales=torch.minimum(model.log_scales, widest))


def _held(model: Gaussians, gradient: Float[Tensor, "gaussian step"], widest: Float[Tensor, "gaussian 1"]) -> Tensor:
    """Which log-scales are widest and would grow, and which coefficients are 0 and would become negative."""
    held = torch.zeros_like(gradient, dtype=torch.bool)
    held[:, SCALES] = (model.log_scales >= widest) & (gradient[:, SCALES] < 0)
    held[:, GEOMETRY:] = (model.coefficients <= 0) & (gradient[:, GEOMETRY:] > 0)
    return held


def _within_reach(step: Float[Tensor, "gaussian step"], model: Gaussians, grid: Grid) -> Float[Tensor, "gaussian step"]:
    """Steps of the geometry cut where the diagonal would no longer hold."""
    wide = REACH[0] * torch.sqrt(_seen_variance(model, grid))
    centres, scales, angles, coefficients = step.split((3, 3, 3, step.shape[1] - GEOMETRY), dim=1)
    scales, angles = scales.clamp(-REACH[1], REACH[1]), angles.clamp(-REACH[2], REACH[2])
    return torch.cat([torch.clamp(centres, -wide, wide), scales, angles, coefficients], dim=1)
