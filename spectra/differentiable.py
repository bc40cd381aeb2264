"""The transmission operator in torch's automatic differentiation."""

from functools import lru_cache
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import torch

from spectra.ops.transmit import expected_and_jacobian, expected_counts

if TYPE_CHECKING:
    from spectra.ops.transmit.gpu import Tables
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


class TransmitOnGpu(torch.autograd.Function):
    """The same by Triton, in the precision of the line integrals; the backward pass computes the parts again."""

    @staticmethod
    def forward(ctx: Any, lengths: torch.Tensor, transmission: "Transmission") -> torch.Tensor:
        """Counts (..., C) of line integrals (..., M)."""
        from spectra.ops.transmit import gpu  # noqa: PLC0415 - needs triton

        rays = lengths.detach().reshape(-1, lengths.shape[-1]).contiguous()
        ctx.transmission = transmission
        ctx.save_for_backward(rays)
        counts = gpu.forward(rays, tables(transmission, lengths.dtype, lengths.device))
        return counts.reshape(*lengths.shape[:-1], len(transmission))

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, gradient: torch.Tensor) -> tuple[torch.Tensor, None]:
        """Gradient in the line integrals."""
        from spectra.ops.transmit import gpu  # noqa: PLC0415

        (rays,) = ctx.saved_tensors
        cotangents = gradient.reshape(len(rays), gradient.shape[-1]).contiguous()
        found = gpu.backward(rays, tables(ctx.transmission, rays.dtype, rays.device), cotangents)
        return found.reshape(*gradient.shape[:-1], rays.shape[1]), None


@lru_cache(maxsize=16)
def tables(transmission: "Transmission", dtype: torch.dtype, device: torch.device) -> "Tables":
    """The nodes on a device, in a precision; kept, as a fit asks for the same ones in every step."""
    from spectra.ops.transmit.gpu import Tables  # noqa: PLC0415

    columns, weights = (torch.tensor(a, dtype=dtype) for a in (transmission.columns.T, transmission.weights))
    return Tables(columns.contiguous().to(device), weights.to(device), torch.tensor(transmission.starts).to(device))


def transmit(lengths: torch.Tensor, transmission: "Transmission") -> torch.Tensor:
    """Expected counts of a tensor of line integrals, (..., M) -> (..., C), differentiable once in `lengths`.

    The result is on the device of `lengths`. On a GPU it is computed by Triton in float32 or float64, as `lengths` is;
    elsewhere, and where Triton is not installed, by numba in float64.
    """
    on_gpu = lengths.device.type == "cuda" and find_spec("triton") is not None
    return (TransmitOnGpu if on_gpu else Transmit).apply(lengths, transmission)
