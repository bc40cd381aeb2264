"""Likelihood for torch tensors, on their device, with the meaning of `recon.ops.likelihood.likelihood`, in float64."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Float32
from torch import Tensor

from recon.ops.deviance import at_bounds, deviance
from recon.ops.likelihood import LEAST, MeasuredCounts
from spectra.differentiable import transmit_and_jacobian
from spectra.transmission import Transmission


class DeviceLikelihood(NamedTuple):
    """Deviance of counts and its derivatives in the line integrals, see `recon.ops.likelihood.Likelihood`.

    Parameters
    ----------
    deviances : sum over each view
    gradient : derivative of half the deviance in the line integrals
    curvatures, residual_curvatures : of each ray, upper triangle row by row; None where not requested
    """

    deviances: Float[Tensor, " view"]
    gradient: Float32[Tensor, "basis view row column"]
    curvatures: Float32[Tensor, "pair view row column"] | None
    residual_curvatures: Float32[Tensor, "pair view row column"] | None


def likelihood(
    lengths: Float[Tensor, "basis view row column"],
    measured: MeasuredCounts,
    transmission: Transmission,
    dispersion: float,
    information: bool = False,
) -> DeviceLikelihood:
    """Compute the deviance of each view, the gradient of half of it, and the curvatures of the rays.

    Parameters
    ----------
    lengths : line integrals of every basis [no unit]
    measured, transmission, dispersion, information : as for `recon.ops.likelihood.likelihood`

    Returns
    -------
    deviances, gradient and both curvatures, on the device of the line integrals
    """

    def on_device(values: np.ndarray) -> Tensor:
        return torch.from_numpy(np.ascontiguousarray(values)).to(lengths.device, torch.float64)

    bases, counts = len(lengths), on_device(measured.counts).movedim(1, -1)
    along = lengths.double().movedim(0, -1)
    if measured.profile is not None:
        known = on_device(measured.profile).movedim(0, -1)
        along = torch.cat([along, known.expand(*along.shape[:-1], known.shape[-1])], -1)
    expected, slopes = transmit_and_jacobian(along, transmission)
    scale = on_device(measured.gains).movedim(0, -1) * on_device(measured.exposure)[:, None, None]
    expected, slopes = expected * scale, slopes[..., :bases] * scale[..., None]
    weights = shares = torch.ones((), dtype=torch.float64, device=lengths.device)
    constants = torch.zeros((), dtype=torch.float64, device=lengths.device)
    if measured.statistical_weights is not None:
        weights = on_device(measured.statistical_weights).movedim(1, -1)
        counts, shares, constants = at_bounds(counts, weights, expected, dispersion)
        weights = torch.where(weights < 0, 2.0, weights)  # of curvatures, the most that a lower bound can have
    used = expected >= LEAST
    per_count = deviance(counts, expected.clamp(min=LEAST), dispersion)
    per_count = torch.where(used | ((counts > 0) & (scale > 0)), shares * per_count + constants, 0.0)
    safe = torch.where(used, expected, 1.0)
    to_counts = torch.where(used, shares * (safe - counts) / (safe * (1 + dispersion**2 * safe)), 0.0)
    gradient = torch.einsum("vrkc,vrkcm->mvrk", to_counts, slopes)
    curvatures = residual = None
    if information:
        most = torch.maximum(safe, counts)
        precision = torch.where(used, weights * most / (safe**2 * (1 + dispersion**2 * most)), 0.0)
        blocks = (slopes * precision[..., None]).mT @ slopes
        rows, columns = np.triu_indices(bases)
        curvatures = blocks[..., rows, columns].movedim(-1, 0).float().contiguous()
        residual = _residual_curvatures(along, to_counts.clamp(min=0) * scale, transmission, bases)
    return DeviceLikelihood(per_count.sum(dim=(1, 2, 3)), gradient.float().contiguous(), curvatures, residual)


def _residual_curvatures(
    along: Float[Tensor, "view row column part"],
    factors: Float[Tensor, "view row column channel"],
    transmission: Transmission,
    bases: int,
) -> Float32[Tensor, "pair view row column"]:
    """Second derivatives of the expected counts times factors of their channels, node by node, which bounds memory."""
    rows, columns = np.triu_indices(bases)
    found = along.new_zeros(len(rows), *along.shape[:-1])
    functions = torch.from_numpy(transmission.columns).to(along)
    for channel, (first, last) in enumerate(pairwise(transmission.starts.tolist())):
        for node in range(first, last):
            left = factors[..., channel] * torch.exp(-along @ functions[:, node]) * float(transmission.weights[node])
            for pair, (m, n) in enumerate(zip(rows, columns, strict=True)):
                found[pair] += left * (functions[m, node] * functions[n, node])
    return found.float()
