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
    """Expected counts as a torch function, computed on the CPU; the Jacobian is stored for the backward pass."""

    @staticmethod
    def forward(ctx: Any, lengths: torch.Tensor, transmission: "Transmission") -> torch.Tensor:
        """Compute expected counts in float64.

        Parameters
        ----------
        ctx : torch's context
        lengths : line integrals, (..., M)
        transmission : source, detector and columns

        Returns
        -------
        counts, (..., C), in the dtype of `lengths`
        """
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
        """Compute the gradient in the line integrals: dY_c/dL_m summed over channels.

        Parameters
        ----------
        ctx : torch's context
        gradient : gradient in the counts, (..., C)

        Returns
        -------
        gradient in the line integrals, (..., M), and None for the transmission
        """
        (jacobian,) = ctx.saved_tensors
        return torch.einsum("...c,...cm->...m", gradient, jacobian), None


class TransmitOnGpu(torch.autograd.Function):
    """Expected counts as a torch function, computed by Triton in the precision of the line integrals.

    The backward pass computes the exponentials again, so that no Jacobian is stored.
    """

    @staticmethod
    def forward(ctx: Any, lengths: torch.Tensor, transmission: "Transmission") -> torch.Tensor:
        """Compute expected counts.

        Parameters
        ----------
        ctx : torch's context
        lengths : line integrals on a GPU, (..., M)
        transmission : source, detector and columns

        Returns
        -------
        counts, (..., C)
        """
        from spectra.ops.transmit import gpu  # noqa: PLC0415 - needs triton

        rays = lengths.detach().reshape(-1, lengths.shape[-1]).contiguous()
        ctx.transmission = transmission
        ctx.save_for_backward(rays)
        counts = gpu.forward(rays, tables(transmission, lengths.dtype, lengths.device))
        return counts.reshape(*lengths.shape[:-1], len(transmission))

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, gradient: torch.Tensor) -> tuple[torch.Tensor, None]:
        """Compute the gradient in the line integrals.

        Parameters
        ----------
        ctx : torch's context
        gradient : gradient in the counts, (..., C)

        Returns
        -------
        gradient in the line integrals, (..., M), and None for the transmission
        """
        from spectra.ops.transmit import gpu  # noqa: PLC0415

        (rays,) = ctx.saved_tensors
        cotangents = gradient.reshape(len(rays), gradient.shape[-1]).contiguous()
        found = gpu.backward(rays, tables(ctx.transmission, rays.dtype, rays.device), cotangents)
        return found.reshape(*gradient.shape[:-1], rays.shape[1]), None


@lru_cache(maxsize=16)
def tables(transmission: "Transmission", dtype: torch.dtype, device: torch.device) -> "Tables":
    """Return the nodes of a transmission on a device; cached, because a fit requires the same ones in every step.

    Parameters
    ----------
    transmission : source, detector and columns
    dtype : precision of the tables
    device : device that holds them

    Returns
    -------
    columns, weights and starts of the nodes
    """
    from spectra.ops.transmit.gpu import Tables  # noqa: PLC0415

    columns, weights = (torch.tensor(a, dtype=dtype) for a in (transmission.columns.T, transmission.weights))
    return Tables(columns.contiguous().to(device), weights.to(device), torch.tensor(transmission.starts).to(device))


def transmit(lengths: torch.Tensor, transmission: "Transmission") -> torch.Tensor:
    """Compute expected counts of line integrals, differentiable once in `lengths`.

    The result is on the device of `lengths`. On a GPU it is computed by Triton in float32 or float64, as `lengths` is;
    elsewhere, and where Triton is not installed, by numba in float64.

    Parameters
    ----------
    lengths : line integrals, (..., M)
    transmission : source, detector and columns

    Returns
    -------
    counts, (..., C), on the device and in the dtype of `lengths`
    """
    on_gpu = lengths.device.type == "cuda" and find_spec("triton") is not None
    return (TransmitOnGpu if on_gpu else Transmit).apply(lengths, transmission)
