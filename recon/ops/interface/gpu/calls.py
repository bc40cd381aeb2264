"""Calls of the operators of divided Gaussians on a GPU, differentiable by torch.

The numbers of a view are computed again for its gradients; see `recon.ops.rasterize.gpu_calls` for the memory.
"""

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
        ctx.save_for_backward(centres, log_scales, quaternions, planes, below, above)
        frames = frames.double()
        ctx.settings = frames, panel, projector
        shape = (len(frames), below.shape[1], *panel)
        images = torch.empty(shape, dtype=below.dtype, device=below.device)
        near = torch.empty((len(frames), len(centres)), dtype=torch.bool, device=below.device)
        matrices, sides = whitening(log_scales.double(), quaternions.double()), _sides(below, above)
        for some in view_portions(len(frames), len(centres)):
            seen = SeenGaussians(centres.double(), matrices, planes.double(), frames[some], panel, projector)
            part = pixels.forward(seen.rounded(), sides, panel, projector.cutoff)
            images[some], near[some] = part * ray_lengths(frames[some], panel), seen.near
        ctx.mark_non_differentiable(near)
        return images, near

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, *cotangents):
        (*geometry, below, above), (frames, panel, projector) = ctx.saved_tensors, ctx.settings
        leaves = [part.detach().double().requires_grad_() for part in geometry]
        with torch.enable_grad():
            matrices = whitening(leaves[1], leaves[2])
        parts = [part.detach().requires_grad_() for part in (leaves[0], matrices, leaves[3])]
        to_parts, sides = [torch.zeros_like(part) for part in parts], _sides(below, above)
        to_below, to_step = (torch.zeros_like(below, dtype=torch.float64) for _ in sides)
        for some in view_portions(len(frames), len(below)):
            scaled = (cotangents[0][some] * ray_lengths(frames[some], panel)).float().contiguous()
            with torch.enable_grad():
                seen = SeenGaussians(parts[0], parts[1], parts[2], frames[some], panel, projector)
            sums, *to_some = pixels.backward(seen.rounded(), sides, scaled, projector.cutoff)
            found = torch.autograd.grad(seen.numbers, parts, seen.gradients(sums.double()))
            to_sides = (part.sum(0, dtype=torch.float64) for part in to_some)
            for whole, part in zip((*to_parts, to_below, to_step), (*found, *to_sides), strict=True):
                whole.add_(part)
        to_shape = torch.autograd.grad(matrices, leaves[1:3], to_parts[1])
        gradients = to_parts[0], *to_shape, to_parts[2], to_below - to_step, to_step
        return *(g.to(part.dtype) for g, part in zip(gradients, ctx.saved_tensors, strict=True)), None, None, None


class _Voxelize(torch.autograd.Function):
    @staticmethod
    def forward(ctx, *arguments):
        *_, below, above, grid, cutoff = arguments
        ctx.save_for_backward(*arguments[:6])
        ctx.settings = grid, cutoff
        found = GaussiansOnGrid(DividedTensors(*arguments[:6]).exact(), grid).rounded(grid.shape, cutoff)
        return voxels.forward(found, _sides(below, above), grid.shape, cutoff).to(below.dtype)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, *cotangents):
        (*geometry, below, above), (grid, cutoff) = ctx.saved_tensors, ctx.settings
        leaves = [part.detach().double().requires_grad_() for part in geometry]
        with torch.enable_grad():
            found = GaussiansOnGrid(DividedTensors(leaves[0], leaves[1], leaves[2], leaves[3], below, above), grid)
        sums, to_below, to_step = voxels.backward(
            found.rounded(grid.shape, cutoff), _sides(below, above), cotangents[0].float().contiguous(), cutoff
        )
        to_leaves = torch.autograd.grad(found.numbers, leaves, found.gradients(sums.double()))
        gradients = *to_leaves, to_below - to_step, to_step
        return *(g.to(part.dtype) for g, part in zip(gradients, ctx.saved_tensors, strict=True)), None, None
