"""One call of the rasterizer on a GPU, view by view: footprints by torch in float64, pixels by Triton in float32.

What a view needs is made again for its gradients, so that memory does not grow with views: some 3 kB per Gaussian.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from recon.ops.rasterize import gpu
from recon.ops.rasterize.cpu_calls import Settings
from recon.ops.rasterize.footprints import footprints, near_images, whitening

NEAR_NUMBERS = 2**22  # Gaussians near an end of the rays, times pixels, at a time


def rasterize_on_gpu(
    centres: Float[Tensor, "gaussian 3"],
    log_scales: Float[Tensor, "gaussian 3"],
    quaternions: Float[Tensor, "gaussian 4"],
    coefficients: Float[Tensor, "gaussian basis"],
    frames: Float[Tensor, "view 4 3"],
    settings: Settings,
) -> Float[Tensor, "view basis row column"]:
    """What `recon.ops.rasterize.rasterize` gives, on the device of the Gaussians."""
    return _RasterizeOnGpu.apply(centres, log_scales, quaternions, coefficients, frames, settings)  # type: ignore[return-value]


class _RasterizeOnGpu(torch.autograd.Function):
    @staticmethod
    def forward(ctx, centres, log_scales, quaternions, coefficients, frames, settings):
        frames = frames.to(device=centres.device, dtype=torch.float64)
        ctx.save_for_backward(centres, log_scales, quaternions, coefficients, frames)
        ctx.settings = settings
        shape = (len(frames), coefficients.shape[1], settings.rows, settings.columns)
        images = torch.empty(shape, dtype=torch.float32, device=centres.device)
        weights, matrices = coefficients.float().contiguous(), whitening(log_scales.double(), quaternions.double())
        for view, frame in enumerate(frames):
            found, near = footprints(centres.double(), matrices, frame, settings)
            image = gpu.forward(found.rounded(), weights, settings.rows, settings.columns, settings.cutoff)
            for some in _pieces(near, settings):
                group = centres[some].double(), matrices[some], weights[some].double()
                image += near_images(*group, frame, settings)
            images[view] = image * _lengths(frame, settings)
        return images.to(coefficients.dtype)

    @staticmethod
    def backward(ctx, *cotangents):
        centres, log_scales, quaternions, coefficients, frames = ctx.saved_tensors
        settings, weights = ctx.settings, coefficients.float().contiguous()
        leaves = [part.detach().double().requires_grad_() for part in (centres, log_scales, quaternions)]
        with torch.enable_grad():
            matrices = whitening(leaves[1], leaves[2])
        parts = places, shapes = leaves[0].detach().requires_grad_(), matrices.detach().requires_grad_()
        to_parts, to_weights = (
            [torch.zeros_like(part) for part in parts],
            torch.zeros_like(weights, dtype=torch.float64),
        )
        for frame, cotangent in zip(frames, cotangents[0], strict=True):
            scaled = (cotangent * _lengths(frame, settings)).float().contiguous()
            with torch.enable_grad():
                found, near = footprints(places, shapes, frame, settings)
            rounded = found.rounded()
            sums, to_some = gpu.backward(rounded, weights, scaled, settings.cutoff)
            to_weights += to_some
            to_numbers = found.gradients(sums.double(), settings.affine)
            for whole, part in zip(to_parts, torch.autograd.grad(found.numbers, parts, to_numbers), strict=True):
                whole.add_(part)
            for some in _pieces(near, settings):
                a, b, c = group = [part.detach()[some].requires_grad_() for part in (*parts, weights.double())]
                with torch.enable_grad():
                    image = near_images(a, b, c, frame, settings)
                *to_group, to_some = torch.autograd.grad(image, group, scaled.double())
                for whole, part in zip(to_parts, to_group, strict=True):
                    whole[some] += part
                to_weights[some] += to_some
        to_shape = torch.autograd.grad(matrices, leaves[1:], to_parts[1])
        gradients = zip((to_parts[0], *to_shape, to_weights), ctx.saved_tensors, strict=False)
        return *(gradient.to(part.dtype) for gradient, part in gradients), None, None


def _pieces(which: Tensor, settings: Settings) -> tuple[Tensor, ...]:
    """Gaussians near an end of the rays, few at a time."""
    size = max(1, NEAR_NUMBERS // max(settings.rows * settings.columns, 1))
    return which.split(size) if len(which) else ()


def _lengths(frame: Float[Tensor, "4 3"], settings: Settings) -> Tensor:
    """Length |d| of each ray [mm]; 1 in the local-affine projection, whose footprints hold one length each."""
    if settings.affine:
        return torch.ones((), device=frame.device)
    x, y = (torch.arange(size, device=frame.device)[:, None] for size in (settings.columns, settings.rows))
    return (frame[1] + x * frame[2] + (y * frame[3])[:, None]).norm(dim=-1).float()
