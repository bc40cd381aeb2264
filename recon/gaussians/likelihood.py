"""The data term F_data of the objective (`recon.gaussians.objective`): deviance, chi-square and gradients of views.

Images of all channels are held for one view at a time, so that memory does not grow with the views of a step. A ray is
computed in the same way whichever others are computed with it, so that this changes no bit of the gradients. All is
computed on the device of the model; only sums are copied to the processor.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from recon.data.measurements import Measurements
from recon.gaussians.model import GaussianModel
from recon.gaussians.processes import ALONE, Processes
from recon.ops.deviance import chi_square, deviance, expected_chi_square, expected_deviance
from recon.voxel.model import Voxels
from spectra.differentiable import transmit

MOST_NEGATIVE = 0.1  # no unit; bound of negative line integrals; those of models that fit are above -0.01


@dataclass(frozen=True, eq=False)
class Likelihood:
    """How well a model explains some views.

    Parameters
    ----------
    deviance : twice F_data, over its expected value for a true model, which makes 1 that of noise alone [no unit]; see
        `recon.ops.deviance`
    chi_square : sum over the pixels of each channel that measure, (C,), over its expected value for a true model [no
        unit]; without statistical weights; NaN for a channel without such pixels
    """

    deviance: float
    chi_square: Float[np.ndarray, " channel"]


def likelihood(
    model: GaussianModel | Voxels, data: Measurements, dispersion: float, processes: Processes = ALONE
) -> Likelihood:
    """Compute the likelihood of a model with all views.

    Parameters
    ----------
    model : Gaussians or voxels
    data : views
    dispersion : eta, relative model error [no unit]
    processes : those that share the views

    Returns
    -------
    deviance and chi-square of all views
    """
    sums = torch.zeros(2 * data.counts.shape[1] + 2, dtype=torch.float64, device="cpu")
    with torch.no_grad():
        for view in processes.share(np.arange(len(data))):
            one = data[[int(view)]]
            sums += _view_sums(model.line_integrals(one.geometry), one, dispersion)[1]
    return _summed(sums, processes)


def deviances(model: GaussianModel | Voxels, data: Measurements, dispersion: float) -> Float[np.ndarray, " view"]:
    """Compute the deviance of each view, twice its part of F_data.

    Parameters
    ----------
    model : Gaussians or voxels
    data : views
    dispersion : eta, relative model error [no unit]

    Returns
    -------
    sums over the counts of each view with their statistical weights, (V,)
    """
    with torch.no_grad():
        ones = [data[[view]] for view in range(len(data))]
        return np.array([float(_view_sums(model.line_integrals(o.geometry), o, dispersion)[1][0]) for o in ones])


def likelihood_and_gradients(
    gaussians: GaussianModel,
    data: Measurements,
    views: Int[np.ndarray, " view"],
    dispersion: float,
    processes: Processes = ALONE,
) -> Likelihood:
    """Compute the likelihood with some views, and leave the gradients of the mean deviance in the arrays of a model.

    Parameters
    ----------
    gaussians : model whose arrays require gradients
    data : views
    views : indices of the views to use
    dispersion : eta, relative model error [no unit]
    processes : those that share the views; all are left with the gradients of all views

    Returns
    -------
    likelihood with these views; gradients are of twice F_data over the number of their counts
    """
    parts = list(gaussians.tensors().values())
    values = len(views) * int(np.prod(data.counts.shape[1:]))
    sums = torch.zeros(2 * data.counts.shape[1] + 2, dtype=torch.float64, device="cpu")
    mine = data[processes.share(views)]
    for part in parts:
        part.grad = None
    if len(mine):
        images = gaussians.line_integrals(mine.geometry)
        known, ray_gradient = images.detach(), torch.empty_like(images)
        for view in range(len(mine)):
            lengths = known[view : view + 1].requires_grad_()
            loss, found = _view_sums(lengths, mine[[view]], dispersion)
            ray_gradient[view] = torch.autograd.grad(loss / values, lengths)[0][0]
            sums += found
        images.backward(ray_gradient)
    else:
        for part in parts:
            part.grad = torch.zeros_like(part)
    processes.add_up([part.grad for part in parts if part.grad is not None])
    return _summed(sums, processes)


def _view_sums(
    images: Float[Tensor, "1 basis row column"], one: Measurements, dispersion: float
) -> tuple[Tensor, Float[Tensor, " sum"]]:
    """Compute the sum of the deviance; and as numbers that sum, chi-square per channel, and expected values of both."""
    counts, expected, measuring = _counts(images, one)
    statistical_weights = (
        1.0 if one.statistical_weights is None else torch.from_numpy(one.statistical_weights).to(images.device)
    )
    loss = (statistical_weights * deviance(counts, expected, dispersion)).sum()
    with torch.no_grad():
        found = torch.where(measuring, chi_square(counts, expected, dispersion), 0.0)
        noise = torch.where(measuring, expected_chi_square(expected, dispersion), 0.0)
        weighted_noise = statistical_weights * expected_deviance(expected, dispersion)
        least = torch.where(measuring, weighted_noise, 0.0).sum()
        parts = [loss.reshape(1), found.sum(dim=(0, 2, 3)), least.reshape(1), noise.sum(dim=(0, 2, 3))]
        return loss, torch.cat([part.double().cpu() for part in parts])


def bounded(images: Float[Tensor, "view basis row column"]) -> Float[Tensor, "view basis row column"]:
    """Keep line integrals above `-MOST_NEGATIVE`, with a gradient everywhere; those that are not negative stay.

    Gaussians of either sign may add up to less than nothing along a ray, and expected counts would overflow.

    Parameters
    ----------
    images : line integrals [no unit]

    Returns
    -------
    L where L is not negative, else L / (1 - L / MOST_NEGATIVE)
    """
    below = images.clamp(max=0)
    return torch.where(images < 0, below / (1 - below / MOST_NEGATIVE), images)


class _Counts(NamedTuple):
    """Measured counts y, expected counts Y, and which pixels measure; (V, C, R, K) or broadcast to it."""

    measured: Tensor
    expected: Tensor
    measuring: Tensor


def _counts(images: Float[Tensor, "view basis row column"], data: Measurements) -> _Counts:
    """Compute expected counts of line integrals, beside the measured ones."""
    gains = torch.from_numpy(data.gains * data.exposure[:, :, None, None].astype(np.float32)).to(images.device)
    lengths = bounded(images).movedim(1, -1).contiguous()
    if data.profile is not None:
        known = torch.from_numpy(data.profile).to(lengths).movedim(0, -1)
        lengths = torch.cat([lengths, known.expand(len(lengths), *known.shape)], dim=-1)
    expected = transmit(lengths, data.transmission).movedim(-1, 1) * gains
    return _Counts(torch.from_numpy(data.counts).to(images.device), expected, gains > 0)


def _summed(sums: Float[Tensor, " sum"], processes: Processes) -> Likelihood:
    """Divide sums over the views of all processes by their expected values."""
    processes.add_up([sums])
    (total, *squares), (least, *noise) = np.array(sums.tolist()).reshape(2, -1)
    found = np.divide(squares, noise, out=np.full(len(noise), np.nan), where=np.array(noise) > 0)
    return Likelihood(float(total / least) if least > 0 else 0.0, found)
