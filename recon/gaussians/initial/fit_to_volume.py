r"""The fit of Gaussians to the voxel volumes, before any rays are used.

It lowers the squared distance

.. math::

    D(\theta) = \tfrac{1}{2} \sum_x \Delta(x)^\mathsf{T} M \Delta(x),
        \quad \Delta_m(x) = \mu_m(x; \theta) - \mu^0_m(x),
        \quad b_{im} \ge 0

with the metric M of `metric_of` (trace 1), mu the means of the model over voxels and mu0 the volumes. Every evaluation
voxelizes the model and the gradient, which costs a few per cent of a sweep over all views. The steps are accelerated
gradient steps (Nesterov 1983), divided by the diagonal of the curvature that single Gaussians would have, in the frame
of each Gaussian's own axes; momentum is dropped where it leads uphill (O'Donoghue & Candes 2015,
doi:10.1007/s10208-013-9150-3). Limited-memory BFGS needs two thirds of the evaluations on large models, but its path
depends on the last digits: noise of 1e-6 in the volumes, as large as the rounding of another processor, changed fits of
small scans by up to 0.3 dB, and changes those with these steps by less than 0.1 dB.

Two kinds of unknowns are held at bounds: a coefficient at 0 that would become negative, and the longest standard
deviation of a Gaussian at twice that of the start. A long thin Gaussian through even tissue hardly shows in voxels, but
in a view along it its ends, which extend beyond the tissue, are seen in full.

Means of voxels do not determine the density within a voxel: a thin dense sheet in the middle of the last voxel before a
face fits them better than an even density whose edge reaches into the next voxel, but line integrals along the face
differ by 7 to 10 %. So D is also computed on a second grid, half a voxel further along every axis, whose voxels hold
the means of the eight voxels that meet there, and added with a small weight.
"""

import math
from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from phantomgen.geometry.voxel_grid import Grid
from recon.gaussians.initial.descent import descend
from recon.gaussians.initial.local_frame import GEOMETRY, SCALES, gradient_of_steps, moved
from recon.gaussians.model import Gaussians
from recon.gaussians.settings import VolumeFitSettings
from recon.ops.voxelize import mass_within, voxelize_tensor
from recon.voxel.method import OnIteration, Report, no_callback

DEFAULT = VolumeFitSettings()
LEAST_CURVATURE = 1e-12  # no unit; added to the diagonal, so that a Gaussian without coefficients is not divided by 0
LEAST_OVERLAP = 1e-3  # voxels; sum of squares of a Gaussian that lies outside of the grid, for the same purpose


def fit_to_volume(
    start: Gaussians,
    volumes: Float[np.ndarray, "basis z y x"],
    grid: Grid,
    metric: Float[np.ndarray, "basis basis"],
    evaluations: int,
    on_evaluation: OnIteration = no_callback,
    settings: VolumeFitSettings = DEFAULT,
) -> Gaussians:
    """Fit Gaussians to volumes.

    Parameters
    ----------
    start : first Gaussians; their number does not change
    volumes : mu0, (M, Z, Y, X) [1/mm]
    grid : voxels of `volumes`
    metric : weights of the bases, see `metric_of`; only its ratio to its trace matters
    evaluations : number of voxelizations, each with its gradient, see `evaluations_for`
    on_evaluation : called after each evaluation; its residual is D
    settings : lengths of the steps, bounds and cutoff

    Returns
    -------
    Gaussians closer to the volumes
    """
    report = Report(on_evaluation, evaluations)
    problem = _Distance(torch.from_numpy(volumes).to(start.centres), metric, grid, report, settings)
    problem.widest = start.log_scales.amax(dim=1, keepdim=True) + math.log(settings.widest)
    return descend(start.detached(), problem, evaluations, settings)


def evaluations_for(gaussians: int, asked: int, settings: VolumeFitSettings = DEFAULT) -> int:
    """Choose the number of evaluations: more for few Gaussians, which reach the minimum in little time.

    Far from the minimum the path depends on the last digits of the volumes, and so on the processor; near it, it does
    not.

    Parameters
    ----------
    gaussians : number of Gaussians
    asked : evaluations for `VolumeFitSettings.many` Gaussians and more
    settings : what is many, and the largest factor

    Returns
    -------
    number of evaluations
    """
    return round(asked * min(max(math.sqrt(settings.many / max(gaussians, 1)), 1.0), settings.most))


def metric_of(
    volumes: Float[np.ndarray, "basis z y x"],
    fisher: Float[np.ndarray, "basis basis"],
    settings: VolumeFitSettings = DEFAULT,
) -> Float[np.ndarray, "basis basis"]:
    """Compute a metric in which the differences of every basis are relative to its large values.

    With the mean Fisher matrix as the metric, the other bases would compensate what Gaussians cannot reproduce in one.

    Parameters
    ----------
    volumes : mu0, (M, Z, Y, X) [1/mm]
    fisher : mean Fisher matrix of the rays' line integrals, whose noise decides which basis is faint [no unit]
    settings : which values are large, and how faint a basis may be

    Returns
    -------
    diagonal matrix M, 1 over the square of each basis' large values [mm^2]
    """
    peaks = np.array([np.quantile(v[v > 0], settings.peak) if (v > 0).any() else 0.0 for v in volumes])
    precision = np.sqrt(np.diag(fisher))
    signals = np.maximum(peaks * precision, settings.faintest * (peaks * precision).max())
    return np.diag((precision / np.maximum(signals, 1e-30)) ** 2)


class _Distance:
    """The distance D of a model from volumes, its gradient, and the diagonal of its curvature."""

    def __init__(
        self,
        volumes: Float[Tensor, "basis z y x"],
        metric: Float[np.ndarray, "basis basis"],
        grid: Grid,
        report: Report,
        settings: VolumeFitSettings,
    ) -> None:
        cutoff = settings.cutoff
        self.grid, self.settings = grid, settings
        self.targets = [(grid, mass_within(cutoff) * volumes, 1.0)]
        if min(grid.shape) > 1 and settings.halfway > 0:
            self.targets.append((halfway(grid), mass_within(cutoff) * means_halfway(volumes), settings.halfway))
        self.metric = torch.from_numpy(metric / np.trace(metric)).to(volumes)
        self.inverse_metric = torch.linalg.inv(self.metric)
        self.evaluations, self.report = 0, report
        self.widest = torch.empty(0)

    def evaluate(self, model: Gaussians) -> tuple[float, Float[Tensor, "gaussian step"]]:
        """Compute D, and its gradient with respect to steps."""
        parts = [p.detach().requires_grad_() for p in _parts(model)]
        distance, on_voxels, shown = 0.0, 0.0, torch.empty(0)
        for grid, target, weight in self.targets:
            found = voxelize_tensor(parts[0], parts[1], parts[2], parts[3], grid, cutoff=self.settings.cutoff)
            difference = found.detach() - target
            weighted = weight * torch.einsum("mn,nzyx->mzyx", self.metric, difference)
            found.backward(weighted)
            # the sum over rows first is ten times as fast
            part = 0.5 * float((difference * weighted).sum(dim=-1).sum(dtype=torch.float64))
            distance += part
            if grid == self.grid:
                on_voxels, shown = part, found.detach()
        self.evaluations += 1
        self.report(shown.cpu().numpy(), on_voxels, self.grid)
        return distance, gradient_of_steps(model, [p.grad for p in parts if p.grad is not None])

    def renew_diagonal(self, model: Gaussians) -> None:
        """Compute the curvature along each step: that of a Gaussian that is alone, times the overlap with others.

        A Gaussian with variances s^2 along its axes, averaged over voxels of variance h^2/12, has the variances t = s^2
        + h^2/12 and the norm E = int g^2. Then int (dg/dp)^2 = E / (2 t) for a move p along an axis; for a log-scale it
        is E ((1 - r)^2 + (1 - r) r + 3/4 r^2) with r = s^2 / t; for a rotation in the plane of two axes it is
        E (t1 - t2)^2 / (4 t1 t2).
        """
        geometry, one = _parts(model)[:3], torch.ones_like(model.coefficients[:, :1]).requires_grad_()
        density = voxelize_tensor(*geometry, one, self.grid, cutoff=self.settings.cutoff)
        density.backward(density.detach())
        assert one.grad is not None
        overlap = one.grad[:, 0]  # sum over voxels of the Gaussian times the sum of all Gaussians
        power = torch.einsum("gm,mn,gn->g", model.coefficients, self.metric, model.coefficients)
        energy = (overlap * (power + self.settings.least_energy * power.mean()))[:, None]
        variance, seen = torch.exp(2 * model.log_scales), _voxel_mean_variance(model, self.grid)
        own = variance / seen  # the rest is that of the voxel
        left, right = seen.roll(-1, dims=1), seen.roll(-2, dims=1)
        curvatures = torch.cat(
            [
                0.5 / seen,
                (1 - own) ** 2 + (1 - own) * own + 0.75 * own**2,
                (left - right) ** 2 / (4 * left * right) + self.settings.least_turning,
            ],
            dim=1,
        )
        self.curvatures = energy * curvatures + LEAST_CURVATURE
        self.overlap = overlap.clamp_min(LEAST_OVERLAP)[:, None]

    def precondition(self, gradient: Float[Tensor, "gaussian step"]) -> Float[Tensor, "gaussian step"]:
        """Divide a gradient by the diagonal of the curvature, and by the metric in the coefficients."""
        geometry = gradient[:, :GEOMETRY] / self.curvatures
        return torch.cat([geometry, gradient[:, GEOMETRY:] @ self.inverse_metric / self.overlap], dim=1)

    def held(self, model: Gaussians, gradient: Float[Tensor, "gaussian step"]) -> Tensor:
        """Find the log-scales that are widest and would grow, and the coefficients at 0 that would become negative."""
        held = torch.zeros_like(gradient, dtype=torch.bool)
        held[:, SCALES] = (model.log_scales >= self.widest) & (gradient[:, SCALES] < 0)
        held[:, GEOMETRY:] = (model.coefficients <= 0) & (gradient[:, GEOMETRY:] > 0)
        return held

    def limited(self, step: Float[Tensor, "gaussian step"], model: Gaussians) -> Float[Tensor, "gaussian step"]:
        """Limit the steps of the geometry to lengths for which the diagonal describes the curvature."""
        return _limited(step, model, self.grid, self.settings)

    def moved(
        self, model: Gaussians, step: Float[Tensor, "gaussian step"]
    ) -> tuple[Gaussians, Float[Tensor, "gaussian step"]]:
        """Make a step within the bounds; also returns the step that was made."""
        ahead = moved(model, step)
        ahead = replace(ahead, log_scales=torch.minimum(ahead.log_scales, self.widest))
        step[:, SCALES] = ahead.log_scales - model.log_scales
        step[:, GEOMETRY:] = ahead.coefficients - model.coefficients
        return ahead, step


def halfway(grid: Grid) -> Grid:
    """Return the grid whose voxels are centred on the corners of the voxels of another one.

    Parameters
    ----------
    grid : the other grid

    Returns
    -------
    grid with one voxel more along every axis
    """
    depth, height, width = (n + 1 for n in grid.shape)
    z, y, x = (o - s / 2 for o, s in zip(grid.origin, grid.spacing, strict=True))
    return Grid((depth, height, width), grid.spacing, (z, y, x))


def means_halfway(volumes: Float[Tensor, "basis z y x"]) -> Float[Tensor, "basis z1 y1 x1"]:
    """Return the means over the voxels of `halfway`.

    Parameters
    ----------
    volumes : values of the voxels of a grid

    Returns
    -------
    means of the eight voxels that meet at each corner; outside the grid the nearest voxel is taken
    """
    out = torch.nn.functional.pad(volumes[None], (1, 1, 1, 1, 1, 1), mode="replicate")[0]
    for axis in (1, 2, 3):
        before, after = out.narrow(axis, 0, out.shape[axis] - 1), out.narrow(axis, 1, out.shape[axis] - 1)
        out = 0.5 * (before + after)
    return out.contiguous()


def _parts(model: Gaussians) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    return model.centres, model.log_scales, model.quaternions, model.coefficients


def _voxel_mean_variance(model: Gaussians, grid: Grid) -> Float[Tensor, "gaussian 3"]:
    """Compute the variances, along its axes, of a Gaussian averaged over voxels [mm^2]."""
    return torch.exp(2 * model.log_scales) + min(grid.spacing) ** 2 / 12


def _limited(
    step: Float[Tensor, "gaussian step"], model: Gaussians, grid: Grid, settings: VolumeFitSettings
) -> Float[Tensor, "gaussian step"]:
    """Limit the steps of the geometry to lengths for which the diagonal describes the curvature."""
    longest = settings.longest_move * torch.sqrt(_voxel_mean_variance(model, grid))
    centres, scales, angles, coefficients = step.split((3, 3, 3, step.shape[1] - GEOMETRY), dim=1)
    scales = scales.clamp(-settings.longest_scaling, settings.longest_scaling)
    angles = angles.clamp(-settings.longest_turn, settings.longest_turn)
    return torch.cat([torch.clamp(centres, -longest, longest), scales, angles, coefficients], dim=1)
