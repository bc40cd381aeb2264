"""Calls of the operators of divided Gaussians on a GPU, differentiable by torch.

The numbers of Gaussians are kept for the gradients where those of all views are computed together, and else computed
again; see `recon.ops.rasterize.gpu_calls` for the memory.
"""

from collections.abc import Sequence

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from phantomgen.geometry.voxel_grid import Grid
from recon.ops.interface.arrays import DividedTensors
from recon.ops.interface.gpu import pixels, voxels
from recon.ops.interface.gpu.numbers import GaussiansOnGrid, SeenGaussians
from recon.ops.interface.gpu.pixels import DeviceSides
from recon.ops.rasterize.footprints import whitening
from recon.ops.rasterize.gpu_calls import ray_lengths, view_portions
from recon.ops.rasterize.projector import Projector


def rasterize_on_gpu(
    gaussians: DividedTensors, frames: Float[Tensor, "view 4 3"], panel: tuple[int, int], projector: Projector
) -> tuple[Float[Tensor, "view basis row column"], Bool[Tensor, "view gaussian"]]:
    """Compute the line integrals of `recon.ops.interface.rasterize.rasterize_divided` where the Gaussians are.

    Parameters
    ----------
    gaussians : Gaussians on a GPU
    frames : per view source, d0, column step and row step [mm]
    panel : rows and columns
    projector : how Gaussians are projected; the exact one

    Returns
    -------
    line integrals, dimensionless, without the Gaussians near the source or the panel; which these are
    """
    return _Rasterize.apply(*gaussians, frames.to(gaussians.centres.device), panel, projector)  # type: ignore[return-value]


def voxelize_on_gpu(gaussians: DividedTensors, grid: Grid, cutoff: float) -> Float[Tensor, "basis z y x"]:
    """Compute the means of `recon.ops.interface.voxelize.voxelize_divided` where the Gaussians are.

    Parameters
    ----------
    gaussians : Gaussians on a GPU
    grid : voxels
    cutoff : where a Gaussian ends [standard deviations]

    Returns
    -------
    means [1/mm]
    """
    return _Voxelize.apply(*gaussians, grid, cutoff)  # type: ignore[return-value]


def _sides(below: Tensor, above: Tensor) -> DeviceSides:
    return DeviceSides(below.float().contiguous(), (above - below).float().contiguous())


class _Rasterize(torch.autograd.Function):
    @staticmethod
    def forward(ctx, centres, log_scales, quaternions, planes, below, above, frames, panel, projector):
        parts, frames = (centres, log_scales, quaternions, planes), frames.double()
        ctx.save_for_backward(*parts, below, above)
        ctx.settings = frames, panel, projector
        shape = (len(frames), below.shape[1], *panel)
        images = torch.empty(shape, dtype=below.dtype, device=below.device)
        near = torch.empty((len(frames), len(centres)), dtype=torch.bool, device=below.device)
        sides, portions = _sides(below, above), list(view_portions(len(frames), len(centres)))
        ctx.kept = None
        for some in portions:
            kept = _SomeViews(parts, frames[some], panel, projector, any(ctx.needs_input_grad))
            if len(portions) == 1:
                ctx.kept = kept
            part = pixels.forward(kept.seen.rounded(), sides, panel, projector.cutoff)
            images[some], near[some] = part * ray_lengths(frames[some], panel), kept.seen.near
        ctx.mark_non_differentiable(near)
        return images, near

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, *cotangents):
        (*geometry, below, above), (frames, panel, projector) = ctx.saved_tensors, ctx.settings
        sides = _sides(below, above)
        totals = [torch.zeros_like(part, dtype=torch.float64) for part in (*geometry, below, below)]
        for some in view_portions(len(frames), len(below)):
            scaled = (cotangents[0][some] * ray_lengths(frames[some], panel)).float().contiguous()
            kept = ctx.kept or _SomeViews(geometry, frames[some], panel, projector, True)
            sums, *to_some = pixels.backward(kept.seen.rounded(), sides, scaled, projector.cutoff)
            found = torch.autograd.grad(
                kept.seen.numbers, kept.leaves, kept.seen.gradients(sums.double()), retain_graph=True
            )
            to_sides = (part.sum(0, dtype=torch.float64) for part in to_some)
            for total, part in zip(totals, (*found, *to_sides), strict=True):
                total.add_(part)
        *to_geometry, to_below, to_step = totals
        gradients = *to_geometry, to_below - to_step, to_step
        return *(g.to(part.dtype) for g, part in zip(gradients, ctx.saved_tensors, strict=True)), None, None, None


class _SomeViews:
    """Gaussians in some views, with the arrays of their geometry in float64, which have gradients where asked."""

    def __init__(
        self, parts: Sequence[Tensor], frames: Tensor, panel: tuple[int, int], projector: Projector, gradients: bool
    ) -> None:
        self.leaves = [part.detach().double().requires_grad_(gradients) for part in parts]
        centres, log_scales, quaternions, planes = self.leaves
        with torch.set_grad_enabled(gradients):
            matrices = whitening(log_scales, quaternions)
            self.seen = SeenGaussians(centres, matrices, planes, frames, panel, projector)


class _Voxelize(torch.autograd.Function):
    @staticmethod
    def forward(ctx, *arguments):
        *_, below, above, grid, cutoff = arguments
        ctx.save_for_backward(*arguments[:6])
        gradients = any(ctx.needs_input_grad)
        leaves = [part.detach().double().requires_grad_(gradients) for part in arguments[:4]]
        with torch.set_grad_enabled(gradients):
            found = GaussiansOnGrid(DividedTensors(leaves[0], leaves[1], leaves[2], leaves[3], below, above), grid)
        ctx.kept, ellipsoids = (leaves, found, cutoff), found.rounded(grid.shape, cutoff)
        return voxels.forward(ellipsoids, _sides(below, above), grid.shape, cutoff).to(below.dtype)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, *cotangents):
        *_, below, above = ctx.saved_tensors
        (leaves, found, cutoff), cotangent = ctx.kept, cotangents[0].float().contiguous()
        ellipsoids = found.rounded(tuple(cotangent.shape[1:]), cutoff)
        sums, to_below, to_step = voxels.backward(ellipsoids, _sides(below, above), cotangent, cutoff)
        to_leaves = torch.autograd.grad(found.numbers, leaves, found.gradients(sums.double()), retain_graph=True)
        gradients = *to_leaves, to_below - to_step, to_step
        return *(g.to(part.dtype) for g, part in zip(gradients, ctx.saved_tensors, strict=True)), None, None
