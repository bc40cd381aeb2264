"""One call of the rasterizer on a GPU, view by view: footprints by torch in float64, pixels by Triton in float32.

The footprints of a view are computed again for its gradients, so that memory does not grow with the number of views:
some 3 kB per Gaussian.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from recon.ops.arguments import GaussianTensors
from recon.ops.rasterize import gpu
from recon.ops.rasterize.footprints import footprints, near_images, whitening
from recon.ops.rasterize.projector import Projector

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
        for view, frame in enumerate(frames):
            found, near = footprints(centres.double(), matrices, frame, panel, projector)
            image = gpu.forward(found.rounded(), weights, panel, projector.cutoff)
            for some in _pieces(near, panel):
                group = centres[some].double(), matrices[some], weights[some].double()
                image += near_images(group, frame, panel, projector)
            images[view] = image * _lengths(frame, panel, projector)
        return images.to(coefficients.dtype)

    @staticmethod
    def backward(ctx, *cotangents):
        centres, log_scales, quaternions, coefficients, frames = ctx.saved_tensors
        (panel, projector), weights = ctx.settings, coefficients.float().contiguous()
        leaves = [part.detach().double().requires_grad_() for part in (centres, log_scales, quaternions)]
        with torch.enable_grad():
            matrices = whitening(leaves[1], leaves[2])
        parts = places, shapes = leaves[0].detach().requires_grad_(), matrices.detach().requires_grad_()
        to_parts, to_weights = (
            [torch.zeros_like(part) for part in parts],
            torch.zeros_like(weights, dtype=torch.float64),
        )
        for frame, cotangent in zip(frames, cotangents[0], strict=True):
            scaled = (cotangent * _lengths(frame, panel, projector)).float().contiguous()
            with torch.enable_grad():
                found, near = footprints(places, shapes, frame, panel, projector)
            rounded = found.rounded()
            sums, to_some = gpu.backward(rounded, weights, scaled, projector.cutoff)
            to_weights += to_some
            to_numbers = found.gradients(sums.double(), projector.affine)
            for whole, part in zip(to_parts, torch.autograd.grad(found.numbers, parts, to_numbers), strict=True):
                whole.add_(part)
            for some in _pieces(near, panel):
                a, b, c = group = [part.detach()[some].requires_grad_() for part in (*parts, weights.double())]
                with torch.enable_grad():
                    image = near_images((a, b, c), frame, panel, projector)
                *to_group, to_some = torch.autograd.grad(image, group, scaled.double())
                for whole, part in zip(to_parts, to_group, strict=True):
                    whole[some] += part
                to_weights[some] += to_some
        to_shape = torch.autograd.grad(matrices, leaves[1:], to_parts[1])
        gradients = zip((to_parts[0], *to_shape, to_weights), ctx.saved_tensors, strict=False)
        return *(gradient.to(part.dtype) for gradient, part in gradients), None, None, None


def _pieces(which: Tensor, panel: tuple[int, int]) -> tuple[Tensor, ...]:
    """Split Gaussians near an end of the rays into groups that fit into memory."""
    size = max(1, NEAR_NUMBERS // max(panel[0] * panel[1], 1))
    return which.split(size) if len(which) else ()


def _lengths(frame: Float[Tensor, "4 3"], panel: tuple[int, int], projector: Projector) -> Tensor:
    """Compute the length |d| of each ray [mm]; 1 in the local-affine projection, whose footprints hold one each."""
    if projector.affine:
        return torch.ones((), device=frame.device)
    x, y = (torch.arange(size, device=frame.device)[:, None] for size in (panel[1], panel[0]))
    return (frame[1] + x * frame[2] + (y * frame[3])[:, None]).norm(dim=-1).float()
