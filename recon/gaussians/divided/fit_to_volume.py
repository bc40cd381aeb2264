"""The fit of divided Gaussians to voxel volumes, before any rays are used.

It lowers the squared distance of `recon.gaussians.initial.fit_to_volume` by the same steps, with coefficients of either
sign: sums of overlapping Gaussians come closer to an even density so, by 1 to 5 dB in Compton scattering.
"""

import math
from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from phantomgen.geometry.voxel_grid import Grid
from recon.gaussians.divided.model import CUTOFF, DividedGaussians
from recon.gaussians.divided.steps import (
    GEOMETRY,
    SCALES,
    TURNS,
    curvature_of_geometry,
    gradient_of_steps,
    moved,
)
from recon.gaussians.initial.descent import descend
from recon.gaussians.settings import SurfaceSettings, VolumeFitSettings
from recon.ops.voxelize import mass_within
from recon.voxel.method import OnIteration, Report, no_callback

DEFAULT = replace(VolumeFitSettings(), cutoff=SurfaceSettings().cutoff)
LEAST_CURVATURE = 1e-12  # no unit; added to the diagonal, so that a Gaussian without coefficients is not divided by 0
SOLVE_DAMPING = 1e-3  # no unit; added to the diagonal in the first solution, so that empty sides stay small
LEAST_OVERLAP = 1e-3  # voxels; sum of squares of one side of a Gaussian, at least, for the same purpose


def fit_divided_to_volume(
    start: DividedGaussians,
    volumes: Float[np.ndarray, "basis z y x"],
    grid: Grid,
    metric: Float[np.ndarray, "basis basis"],
    evaluations: int,
    on_evaluation: OnIteration = no_callback,
    settings: VolumeFitSettings = DEFAULT,
) -> DividedGaussians:
    """Fit divided Gaussians to volumes.

    Parameters
    ----------
    start : first Gaussians; their number does not change
    volumes : mu0, (M, Z, Y, X) [1/mm]
    grid : voxels of `volumes`
    metric : weights of the bases, see `recon.gaussians.initial.fit_to_volume.metric_of`
    evaluations : number of voxelizations, each with its gradient
    on_evaluation : called after each evaluation; its residual is the squared distance
    settings : lengths of the steps, bounds and cutoff

    Returns
    -------
    Gaussians closer to the volumes
    """
    report = Report(on_evaluation, evaluations)
    problem = _Distance(volumes, grid, metric, report, settings, start.centres.device)
    problem.widest = start.log_scales.amax(dim=1, keepdim=True) + math.log(settings.widest)
    return descend(start.detached(), problem, evaluations, settings)


def solve_coefficients(
    start: DividedGaussians,
    volumes: Float[np.ndarray, "basis z y x"],
    grid: Grid,
    metric: Float[np.ndarray, "basis basis"],
    iterations: int,
) -> DividedGaussians:
    """Lower the squared distance in the coefficients alone, by conjugate gradients on voxels of twice the size.

    Parameters
    ----------
    start : the model, whose geometry stays
    volumes : mu0, (M, Z, Y, X) [1/mm]
    grid : voxels of `volumes`
    metric : weights of the bases [mm^2]
    iterations : of conjugate gradients, each with a voxelization and its gradient

    Returns
    -------
    the model with other coefficients
    """
    volumes, grid = _of_twice_the_size(volumes, grid)
    report, settings = Report(no_callback, iterations), replace(DEFAULT, cutoff=CUTOFF)
    problem = _Distance(volumes, grid, metric, report, settings, start.centres.device)
    problem.renew_diagonal(start)
    scale = problem.overlap[..., None] * torch.diagonal(problem.metric)
    values = start.coefficients.clone()
    rest = -problem.pulled(start.with_values(values), problem.target)[0] - SOLVE_DAMPING * scale * values
    direction = rest / scale
    square = float((rest * direction).sum(dtype=torch.float64))
    for _ in range(iterations):
        if not square > 0:
            break
        pulled, energy = problem.pulled(start.with_values(direction), None)
        damped = SOLVE_DAMPING * scale * direction
        pulled, energy = pulled + damped, energy + 0.5 * float((direction * damped).sum(dtype=torch.float64))
        length = square / (2 * energy)
        values, rest = values + length * direction, rest - length * pulled
        scaled = rest / scale
        square, last = float((rest * scaled).sum(dtype=torch.float64)), square
        direction = scaled + square / last * direction
    return start.with_values(values)


class _Distance:
    """The squared distance of a model from volumes; a `recon.gaussians.initial.descent.Problem`."""

    def __init__(
        self,
        volumes: Float[np.ndarray, "basis z y x"],
        grid: Grid,
        metric: Float[np.ndarray, "basis basis"],
        report: Report,
        settings: VolumeFitSettings,
        device: torch.device,
    ) -> None:
        self.grid, self.voxel, self.settings, self.report = grid, min(grid.spacing), settings, report
        kept = np.float32(mass_within(settings.cutoff))
        self.target = torch.from_numpy(np.ascontiguousarray(kept * volumes, np.float32)).to(device)
        self.metric = torch.from_numpy(metric / np.trace(metric)).float().to(device)
        self.inverse_metric = torch.linalg.inv(self.metric)
        self.evaluations, self.widest = 0, torch.empty(0)

    def evaluate(self, model: DividedGaussians) -> tuple[float, Float[Tensor, "gaussian step"]]:
        """Compute the distance, and its gradient with respect to steps."""
        parts = {name: value.detach().requires_grad_() for name, value in model.tensors().items()}
        found = model.with_tensors(parts).voxels(self.grid, self.settings.cutoff)
        difference = found.detach() - self.target
        weighted = torch.einsum("mn,nzyx->mzyx", self.metric, difference)
        found.backward(weighted)
        distance = 0.5 * float((difference * weighted).sum(dim=-1).sum(dtype=torch.float64))
        self.evaluations += 1
        self.report(found.detach().cpu().numpy(), distance, self.grid)
        return distance, gradient_of_steps(model, [p.grad for p in parts.values() if p.grad is not None])

    def pulled(self, model: DividedGaussians, target: Tensor | None) -> tuple[Tensor, float]:
        """Compute the gradient of the distance in the coefficients, and the distance; from 0 without a target."""
        values = model.coefficients.detach().requires_grad_()
        found = model.with_values(values).voxels(self.grid, self.settings.cutoff)
        difference = found.detach() if target is None else found.detach() - target
        weighted = torch.einsum("mn,nzyx->mzyx", self.metric, difference)
        found.backward(weighted)
        assert values.grad is not None
        return values.grad, 0.5 * float((difference * weighted).sum(dim=-1).sum(dtype=torch.float64))

    def renew_diagonal(self, model: DividedGaussians) -> None:
        """Compute the curvature along each step: that of a Gaussian that is alone, times the overlap with others."""
        one = torch.ones_like(model.coefficients[..., :1]).requires_grad_()
        density = model.with_values(one).voxels(self.grid, self.settings.cutoff)
        density.backward(density.detach())
        assert one.grad is not None
        overlap, settings = one.grad[..., 0], self.settings  # (N, 2), per side
        geometry = curvature_of_geometry(
            model, self.metric, self.voxel, overlap.sum(dim=1), settings.least_energy, settings.least_turning
        )
        self.curvatures, self.overlap = geometry + LEAST_CURVATURE, overlap.clamp_min(LEAST_OVERLAP)

    def precondition(self, gradient: Float[Tensor, "gaussian step"]) -> Float[Tensor, "gaussian step"]:
        """Divide a gradient by the diagonal of the curvature, and by the metric in the coefficients."""
        sides = gradient[:, GEOMETRY:].unflatten(1, (2, -1)) @ self.inverse_metric / self.overlap[..., None]
        return torch.cat([gradient[:, :GEOMETRY] / self.curvatures, sides.flatten(1)], dim=1)

    def held(self, model: DividedGaussians, gradient: Float[Tensor, "gaussian step"]) -> Bool[Tensor, "gaussian step"]:
        """Find the log-scales that are widest and would grow."""
        held = torch.zeros_like(gradient, dtype=torch.bool)
        held[:, SCALES] = (model.log_scales >= self.widest) & (gradient[:, SCALES] < 0)
        return held

    def limited(self, step: Float[Tensor, "gaussian step"], model: DividedGaussians) -> Float[Tensor, "gaussian step"]:
        """Limit the steps of the geometry to lengths for which the diagonal describes the curvature."""
        settings = self.settings
        longest = settings.longest_move * torch.sqrt(torch.exp(2 * model.log_scales) + self.voxel**2 / 12)
        parts = [
            torch.clamp(step[:, :3], -longest, longest),
            step[:, SCALES].clamp(-settings.longest_scaling, settings.longest_scaling),
            step[:, TURNS].clamp(-settings.longest_turn, settings.longest_turn),
            step[:, 9:10].clamp(-settings.longest_move * self.voxel, settings.longest_move * self.voxel),
            step[:, GEOMETRY:],
        ]
        return torch.cat(parts, dim=1)

    def moved(
        self, model: DividedGaussians, step: Float[Tensor, "gaussian step"]
    ) -> tuple[DividedGaussians, Float[Tensor, "gaussian step"]]:
        """Make a step within the bounds; also returns the step that was made."""
        ahead = moved(model, step)
        ahead = ahead.with_tensors({"log_scales": torch.minimum(ahead.log_scales, self.widest)})
        step[:, SCALES] = ahead.log_scales - model.log_scales
        return ahead, step


def _of_twice_the_size(
    volumes: Float[np.ndarray, "basis z y x"], grid: Grid
) -> tuple[Float[np.ndarray, "basis z1 y1 x1"], Grid]:
    """Average pairs of voxels along every axis that has two; an odd last voxel is paired with an empty one."""
    for axis, n in enumerate(grid.shape):
        if n == 1:
            continue
        volumes = np.pad(volumes, [(0, n % 2 if a == axis + 1 else 0) for a in range(4)])
        even, odd = (np.take(volumes, np.arange(k, volumes.shape[axis + 1], 2), axis=axis + 1) for k in (0, 1))
        volumes = 0.5 * (even + odd)
    twice = [2 * s if n > 1 else s for n, s in zip(grid.shape, grid.spacing, strict=True)]
    origin = [o + (t - s) / 2 for o, s, t in zip(grid.origin, grid.spacing, twice, strict=True)]
    return volumes, Grid(volumes.shape[1:], tuple(twice), tuple(origin))  # type: ignore[arg-type]
