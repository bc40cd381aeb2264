"""The transmission operator in torch's automatic differentiation."""

from typing import TYPE_CHECKING, Any

import torch

from spectra.ops.transmit import expected_and_jacobian, expected_counts

if TYPE_CHECKING:
    from spectra.transmission import Transmission


class Transmit(torch.autograd.Function):
    """Expected counts with the Jacobian kept for the backward pass."""

    @staticmethod
    def forward(ctx: Any, lengths: torch.Tensor, transmission: "Transmission") -> torch.Tensor:
        """Counts (..., C) of line integrals (..., M), in the dtype of `lengths`, computed in float64."""
        rays = lengths.detach().reshape(-1, lengths.shape[-1]).double().cpu().numpy()
        arrays = (transmission.columns, transmission.weights, transmission.starts)
        shape = (*lengths.shape[:-1], len(transmission))
        if not ctx.needs_input_grad[0]:
            return torch.from_numpy(expected_counts(rays, *arrays)).to(lengths).reshape(shape)
        counts, jacobian = expected_and_jacobian(rays, *arrays)
        ctx.save_for_backward(torch.from_numpy(jacobian).to(lengths).reshape(*shape, lengths.shape[-1]))
        return torch.from_numpy(counts).to(lengths).reshape(shape)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, gradient: torch.Tensor) -> tuple[torch.Tensor, None]:
        """Gradient in the line integrals: dY_c/dL_m summed over channels."""
        (jacobian,) = ctx.saved_tensors
        return torch.einsum("...c,...cm->...m", gradient, jacobian), None
