"""One call of the rasterizer on a GPU, some views at a time: footprints by torch in float64, pixels by Triton.

The footprints of a view are computed again for its gradients, so that memory does not grow with the number of views:
some 3 kB per Gaussian and view, and at most 3 GB where one view needs less.
"""

from collections.abc import Iterator

import torch
from jaxtyping import Bool, Float, Float32
from torch import Tensor

from recon.ops.arguments import GaussianTensors
from recon.ops.rasterize import gpu
from recon.ops.rasterize.footprints import footprints, near_images, placed, whitening
from recon.ops.rasterize.projector import Projector

SEEN_AT_ONCE = 2**20  # Gaussians times views at a time
NEAR_NUMBERS = 2**22  # Gaussians near an end of the rays, times pixels, at a time: some 100 MB per vector of a ray


def rasterize_on_gpu(
    gaussians: GaussianTensors, frames: Float[Tensor, "view 4 3"], panel: tuple[int, int], projector: Projector
) -> Float[Tensor, "view basis row column"]:
    """Compute the line integrals of `recon.ops.rasterize.rasterize` on the device of the Gaussians.

    Parameters
    ----------
    gaussians : Gaussians on a GPU
    frames : per view source, d0, column step and row step [mm]
    panel : rows and columns
    projector : how Gaussians are projected

    Returns
    -------
    line integrals, dimensionless
    """
    return _RasterizeOnGpu.apply(*gaussians, frames, panel, projector)  # type: ignore[return-value]


class _RasterizeOnGpu(torch.autograd.Function):
    @staticmethod
    def forward(ctx, centres, log_scales, quaternions, coefficients, frames, panel, projector):
        frames = frames.to(device=centres.device, dtype=torch.float64)
        ctx.save_for_backward(centres, log_scales, quaternions, coefficients, frames)
        ctx.settings = panel, projector
        shape = (len(frames), coefficients.shape[1], *panel)
        images = torch.empty(shape, dtype=torch.float32, device=centres.device)
        weights, matrices = coefficients.float().contiguous(), whitening(log_scales.double(), quaternions.double())
        for some in view_portions(len(frames), len(centres)):
            places = placed(centres.double(), matrices, frames[some], projector)
            found = footprints(places, panel, projector).rounded()
            part = gpu.forward(found, weights, panel, projector.cutoff)
            for view, (frame, near) in enumerate(zip(frames[some], places.near, strict=True)):
                for which in _pieces(near, panel):
                    group = centres[which].double(), matrices[which], weights[which].double()
                    part[view] += near_images(group, frame, panel, projector)
            images[some] = part * _lengths(frames[some], panel, projector)
        return images.to(coefficients.dtype)

    @staticmethod
    def backward(ctx, *cotangents):
        centres, log_scales, quaternions, coefficients, frames = ctx.saved_tensors
        (panel, projector), weights = ctx.settings, coefficients.float().contiguous()
        leaves = [part.detach().double().requires_grad_() for part in (centres, log_scales, quaternions)]
        with torch.enable_grad():
            matrices = whitening(leaves[1], leaves[2])
        parts = where, shapes = leaves[0].detach().requires_grad_(), matrices.detach().requires_grad_()
        to_parts, to_weights = (
            [torch.zeros_like(part) for part in parts],
            torch.zeros_like(weights, dtype=torch.float64),
        )
        for some in view_portions(len(frames), len(centres)):
            scaled = (cotangents[0][some] * _lengths(frames[some], panel, projector)).float().contiguous()
            with torch.enable_grad():
                places = placed(where, shapes, frames[some], projector)
                found = footprints(places, panel, projector)
            sums, to_some = gpu.backward(found.rounded(), weights, scaled, projector.cutoff)
            to_weights += to_some.sum(0, dtype=torch.float64)
            to_numbers = found.gradients(sums.double(), projector.affine)
            for whole, part in zip(to_parts, torch.autograd.grad(found.numbers, parts, to_numbers), strict=True):
                whole.add_(part)
            for cotangent, frame, near in zip(scaled, frames[some], places.near, strict=True):
                for which in _pieces(near, panel):
                    a, b, c = group = [part.detach()[which].requires_grad_() for part in (*parts, weights.double())]
                    with torch.enable_grad():
                        image = near_images((a, b, c), frame, panel, projector)
                    *to_group, to_near = torch.autograd.grad(image, group, cotangent.double())
                    for whole, part in zip(to_parts, to_group, strict=True):
                        whole[which] += part
                    to_weights[which] += to_near
        to_shape = torch.autograd.grad(matrices, leaves[1:], to_parts[1])
        gradients = zip((to_parts[0], *to_shape, to_weights), ctx.saved_tensors, strict=False)
        return *(gradient.to(part.dtype) for gradient, part in gradients), None, None, None


def view_portions(views: int, gaussians: int) -> Iterator[slice]:
    """Split views into groups whose footprints fit into memory.

    Parameters
    ----------
    views, gaussians : how many there are

    Yields
    ------
    views of each group, in order
    """
    size = max(1, SEEN_AT_ONCE // max(gaussians, 1))
    yield from (slice(first, first + size) for first in range(0, views, size))


def _pieces(near: Bool[Tensor, " gaussian"], panel: tuple[int, int]) -> tuple[Tensor, ...]:
    """Split Gaussians near an end of the rays into groups that fit into memory."""
    which = torch.nonzero(near)[:, 0]
    size = max(1, NEAR_NUMBERS // max(panel[0] * panel[1], 1))
    return which.split(size) if len(which) else ()


def _lengths(frames: Float[Tensor, "view 4 3"], panel: tuple[int, int], projector: Projector) -> Tensor:
    """Compute |d| as `ray_lengths` does; 1 in the local-affine projection, whose footprints hold one each."""
    return torch.ones((), device=frames.device) if projector.affine else ray_lengths(frames, panel)


def ray_lengths(frames: Float[Tensor, "view 4 3"], panel: tuple[int, int]) -> Float32[Tensor, "view 1 row column"]:
    """Compute the length |d| of each ray from source to panel.

    Parameters
    ----------
    frames : per view source, d0, column step and row step [mm]
    panel : rows and columns

    Returns
    -------
    lengths [mm]
    """
    x, y = (torch.arange(size, device=frames.device)[:, None] for size in (panel[1], panel[0]))
    first, column_step, row_step = (frames[:, None, None, i] for i in (1, 2, 3))
    return (first + x * column_step + y[:, None] * row_step).norm(dim=-1).float()[:, None]
