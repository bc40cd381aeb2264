"""How well a model explains views, and which way it should move.

Views are taken one at a time where images of all channels are held, so that memory does not grow with the views of a
step; each ray is computed the same way in any company, so that this changes no bit of the gradients. All is computed
on the device of the model; only sums come back.
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from recon.data.measurements import Measurements
from recon.gaussians.model import Gaussians
from recon.gaussians.processes import ALONE, Processes
from recon.ops.deviance import chi_square, deviance, expected_chi_square, expected_deviance
from recon.voxel.model import Voxels
from spectra.differentiable import transmit


@dataclass(frozen=True, eq=False)
class Likelihood:
    """Of a model with some views.

    Parameters
    ----------
    deviance : over what noise alone would leave, which makes it 1 (`recon.ops.deviance`); every count has the say that
        it has in the fit
    chi_square : of the pixels of each channel that measure, over what noise alone would leave; NaN for a channel
        without
    """

    deviance: float
    chi_square: Float[np.ndarray, " channel"]


def likelihood(
    model: Gaussians | Voxels, data: Measurements, dispersion: float, processes: Processes = ALONE
) -> Likelihood:
    """Likelihood with all views of `data`, whose work `processes` share."""
    sums = torch.zeros(2 * data.counts.shape[1] + 2, dtype=torch.float64, device="cpu")
    with torch.no_grad():
        for view in processes.share(np.arange(len(data))):
            one = data[[int(view)]]
            sums += _view_sums(model.line_integrals(one.geometry), one, dispersion)[1]
    return _summed(sums, processes)


def deviances(model: Gaussians | Voxels, data: Measurements, dispersion: float) -> Float[np.ndarray, " view"]:
    """Deviance of each view, summed over counts by the say that they have in the fit."""
    with torch.no_grad():
        ones = [data[[view]] for view in range(len(data))]
        return np.array([float(_view_sums(model.line_integrals(o.geometry), o, dispersion)[1][0]) for o in ones])


def likelihood_and_gradients(
    gaussians: Gaussians,
    data: Measurements,
    views: Int[np.ndarray, " view"],
    dispersion: float,
    processes: Processes = ALONE,
) -> Likelihood:
    """Likelihood with some views of `data`; the gradients of the mean deviance are left in the tensors of `gaussians`.

    Parameters
    ----------
    gaussians : model whose tensors require gradients
    data, views : what was measured, and which views to take
    dispersion : relative model error added to the Poisson variance
    processes : that share the views; all are left with the gradients of all views
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
    """Sum of the deviance; as numbers that sum, chi-square per channel, and what noise alone would leave of both."""
    counts, expected, measuring = _expected(images, one)
    shares = 1.0 if one.shares is None else torch.from_numpy(one.shares).to(images.device)
    loss = (shares * deviance(counts, expected, dispersion)).sum()
    with torch.no_grad():
        found = torch.where(measuring, chi_square(counts, expected, dispersion), 0.0)
        noise = torch.where(measuring, expected_chi_square(expected, dispersion), 0.0)
        least = torch.where(measuring, shares * expected_deviance(expected, dispersion), 0.0).sum()
        parts = [loss.reshape(1), found.sum(dim=(0, 2, 3)), least.reshape(1), noise.sum(dim=(0, 2, 3))]
        return loss, torch.cat([part.double().cpu() for part in parts])


def _expected(images: Float[Tensor, "view basis row column"], data: Measurements) -> tuple[Tensor, Tensor, Tensor]:
    """Measured counts, expected ones, and which pixels measure."""
    gains = torch.from_numpy(data.gains * data.exposure[:, :, None, None].astype(np.float32)).to(images.device)
    lengths = images.movedim(1, -1).contiguous()
    if data.profile is not None:
        known = torch.from_numpy(data.profile).to(lengths).movedim(0, -1)
        lengths = torch.cat([lengths, known.expand(len(lengths), *known.shape)], dim=-1)
    expected = transmit(lengths, data.transmission).movedim(-1, 1) * gains
    return torch.from_numpy(data.counts).to(images.device), expected, gains > 0


def _summed(sums: Float[Tensor, " sum"], processes: Processes) -> Likelihood:
    """Ratios of sums over the views of all processes."""
    processes.add_up([sums])
    (total, *squares), (least, *noise) = np.array(sums.tolist()).reshape(2, -1)
    found = np.divide(squares, noise, out=np.full(len(noise), np.nan), where=np.array(noise) > 0)
    return Likelihood(float(total / least) if least > 0 else 0.0, found)
