"""The transmission operator in torch's automatic differentiation.

`transmit` has gradients in the line integrals and is the fastest; `transmit_spectrum` has gradients in everything: line
integrals, sensitivities of the channels, and functions of energy.
"""

from functools import lru_cache
from importlib.util import find_spec
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import torch
from jaxtyping import Float
from torch import Tensor

from spectra.ops.transmit import expected_and_jacobian, expected_counts

# Rays x energies that are in memory at once.
_MOST = 1 << 21

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


def transmit_and_jacobian(lengths: Tensor, transmission: "Transmission") -> tuple[Tensor, Tensor]:
    """Compute expected counts and their derivatives by plain torch, on the device and in the precision of `lengths`.

    Parameters
    ----------
    lengths : line integrals, (..., M)
    transmission : source, detector and columns

    Returns
    -------
    counts, (..., C), and dY_c/dL_m, (..., C, M)
    """
    columns, weights = (torch.from_numpy(part).to(lengths) for part in (transmission.columns, transmission.weights))
    left = torch.exp(-lengths @ columns) * weights
    counts, slopes = [], []
    for first, last in pairwise(transmission.starts.tolist()):
        counts.append(left[..., first:last].sum(-1))
        slopes.append(-left[..., first:last] @ columns[:, first:last].T)
    return torch.stack(counts, -1), torch.stack(slopes, -2)


class TransmitSpectrum(torch.autograd.Function):
    """Expected counts as a torch function of line integrals, columns and weights; some rays at a time.

    The backward pass computes the transmitted parts again, so that memory does not grow with rays x energies.
    """

    @staticmethod
    def forward(lengths: Tensor, columns: Tensor, weights: Tensor) -> Tensor:
        """Compute expected counts.

        Parameters
        ----------
        lengths : line integrals, (ray, M)
        columns : functions of energy, (M, E)
        weights : photons x response, (C, E)

        Returns
        -------
        counts, (ray, C)
        """
        return torch.cat([torch.exp(-rays @ columns) @ weights.T for rays in lengths.split(_together(columns))])

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Tensor, ...], output: Tensor) -> None:
        """Keep the arguments.

        Parameters
        ----------
        ctx : torch's context
        inputs : arguments of `forward`
        output : counts
        """
        ctx.save_for_backward(*inputs)

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Compute the gradients in all arguments; these can be differentiated again.

        Parameters
        ----------
        ctx : torch's context
        gradient : gradient in the counts, (ray, C)

        Returns
        -------
        gradients in the line integrals, the columns and the weights
        """
        lengths, columns, weights = ctx.saved_tensors
        by_rays, by_columns, by_weights = [], torch.zeros_like(columns), torch.zeros_like(weights)
        together = _together(columns)
        for rays, counts in zip(lengths.split(together), gradient.split(together), strict=True):
            left = torch.exp(-rays @ columns)
            absorbed = left * (counts @ weights)
            by_rays.append(-absorbed @ columns.T)
            by_columns = by_columns - rays.T @ absorbed
            by_weights = by_weights + counts.T @ left
        return torch.cat(by_rays), by_columns, by_weights


def _together(columns: Tensor) -> int:
    """Number of rays that are computed at once."""
    return max(1, _MOST // max(1, columns.shape[1]))


def transmit_spectrum(
    lengths: Float[Tensor, "... basis"],
    columns: Float[Tensor, "basis energy"],
    weights: Float[Tensor, "channel energy"],
) -> Float[Tensor, "... channel"]:
    """Compute expected counts sum_k w_ck exp(-sum_m B_m(E_k) L_m), differentiable in all three arguments.

    Plain torch, on any device, in the precision of `lengths`; `transmit` is faster where only line integrals have
    gradients, as it computes the nodes of a channel alone.

    Parameters
    ----------
    lengths : line integrals, (..., M)
    columns : functions of energy, (M, E)
    weights : photons x response, (C, E)

    Returns
    -------
    counts, (..., C), on the device and in the dtype of `lengths`
    """
    counts = TransmitSpectrum.apply(lengths.flatten(0, -2), columns.to(lengths), weights.to(lengths))
    return counts.unflatten(0, lengths.shape[:-1])  # type: ignore[union-attr]
