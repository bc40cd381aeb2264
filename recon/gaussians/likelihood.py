"""The data term F_data of the objective (`recon.gaussians.objective`): deviance, chi-square and gradients of views.

Images of all channels are held for one view at a time, or on a GPU for some, so that memory does not grow with the
views of a step. A ray is computed in the same way whichever others are computed with it, so that this changes no bit of
the gradients. All is computed on the device of the model; only sums are copied to the processor. A GPU keeps the counts
of a scan, where it has room for them.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from recon.data.measurements import Measurements
from recon.gaussians.model import GaussianModel
from recon.gaussians.processes import ALONE, Processes
from recon.ops.deviance import at_bounds, chi_square, deviance, expected_chi_square, expected_deviance
from recon.ops.likelihood import MeasuredCounts
from recon.ops.likelihood.data_term import data_term
from recon.voxel.model import Voxels
from spectra.differentiable import transmit

KEPT_PART = 0.3  # of a GPU's free memory; counts, gains and weights of a scan that need less are kept there
VALUES_AT_ONCE = 2**24  # views x channels x pixels whose counts a GPU computes together
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
            sums += _gradient_and_sums(model.line_integrals(one.geometry), one, dispersion)[1]
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
        views = (data[[view]] for view in range(len(data)))
        return np.array([deviance_of_images(model.line_integrals(one.geometry), one, dispersion) for one in views])


def deviance_of_images(images: Float[Tensor, "view basis row column"], data: Measurements, dispersion: float) -> float:
    """Compute the deviance of line integrals, twice their part of F_data.

    Parameters
    ----------
    images : line integrals of the views [no unit]
    data : views
    dispersion : eta, relative model error [no unit]

    Returns
    -------
    sum over all counts with their statistical weights
    """
    return float(_gradient_and_sums(images, data, dispersion)[1][0])


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
    mine = processes.share(views)
    for part in parts:
        part.grad = None
    if len(mine):
        images = gaussians.line_integrals(data.geometry[mine])
        gradient, sums = _gradient_and_sums(images.detach(), data, dispersion, mine)
        images.backward(gradient / values)
    else:
        for part in parts:
            part.grad = torch.zeros_like(part)
    processes.add_up([part.grad for part in parts if part.grad is not None])
    return _summed(sums, processes)


def _gradient_and_sums(
    images: Float[Tensor, "view basis row column"],
    data: Measurements,
    dispersion: float,
    views: Int[np.ndarray, " view"] | None = None,
) -> tuple[Float[Tensor, "view basis row column"], Float[Tensor, " sum"]]:
    """Compute the gradient of the deviance of views of the data, all by default, and the numbers of `_sums`."""
    if _has_kernel(images.device):
        return _on_cpu(images, data if views is None else data[views], dispersion)
    views = np.arange(len(data)) if views is None else views
    rays, gradient = _rays_of_step(data, views, images.device), torch.empty_like(images)
    sums = torch.zeros(2 * data.counts.shape[1] + 2, dtype=torch.float64, device=images.device)
    with torch.enable_grad():
        for some in _portions(rays):
            lengths = images[some].detach().requires_grad_()
            loss, found = _sums(lengths, rays.of_views(some), dispersion)
            gradient[some] = torch.autograd.grad(loss, lengths)[0]
            sums += found
    return gradient, sums.cpu()


def _has_kernel(device: torch.device) -> bool:
    """Whether `recon.ops.likelihood.data_term` computes there; elsewhere tensors do."""
    return device.type == "cpu"


def _on_cpu(
    images: Float[Tensor, "view basis row column"], data: Measurements, dispersion: float
) -> tuple[Float[Tensor, "view basis row column"], Float[Tensor, " sum"]]:
    """Compute `_gradient_and_sums` by the processor, in one pass over the rays."""
    counts = MeasuredCounts(data.counts, data.gains, data.exposure, data.profile, data.statistical_weights)
    found = data_term(bounded(images).numpy(), counts, data.transmission, dispersion)
    gradient = torch.from_numpy(found.gradient).to(images)
    below = images.clamp(max=0)
    gradient = 2 * gradient / (1 - below / MOST_NEGATIVE) ** 2
    parts = [found.deviances.sum()], found.chi_squares, [found.noise_deviances.sum()], found.noise_chi_squares
    return gradient, torch.from_numpy(np.concatenate(parts)).cpu()


def _sums(
    images: Float[Tensor, "view basis row column"], rays: "_Rays", dispersion: float
) -> tuple[Tensor, Float[Tensor, " sum"]]:
    """Compute the sum of the deviance; and as numbers that sum, chi-square per channel, and expected values of both."""
    expected = _expected_counts(images, rays)
    measuring, counts, weights = rays.gains > 0, rays.counts, rays.weights
    constant = images.new_zeros(())
    if weights.ndim:
        measuring = measuring & (weights >= 0)
        counts, weights, constant = at_bounds(counts, weights, expected.detach(), dispersion)
    loss = (weights * deviance(counts, expected, dispersion)).sum() + constant.sum()
    with torch.no_grad():
        found = torch.where(measuring, chi_square(counts, expected, dispersion), 0.0)
        noise = torch.where(measuring, expected_chi_square(expected, dispersion), 0.0)
        least = torch.where(rays.gains > 0, weights * expected_deviance(expected, dispersion), 0.0).sum()
        parts = [loss.reshape(1), found.sum(dim=(0, 2, 3)), least.reshape(1), noise.sum(dim=(0, 2, 3))]
        return loss, torch.cat([part.double() for part in parts])


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


class _Rays(NamedTuple):
    """Measured counts, gains times exposure and statistical weights (V, C, R, K) on a device; the rest of the scan."""

    counts: Tensor
    gains: Tensor
    weights: Tensor
    scan: Measurements

    def of_views(self, some: slice | Tensor) -> "_Rays":
        """Take some of the views."""
        weights = self.weights if self.weights.ndim == 0 else self.weights[some]
        return _Rays(self.counts[some], self.gains[some], weights, self.scan)


def _rays(data: Measurements, device: torch.device) -> _Rays:
    """Copy the measurements of all views to a device."""
    gains = data.gains * data.exposure[:, :, None, None].astype(np.float32)
    weights = np.ones((), np.float32) if data.statistical_weights is None else data.statistical_weights
    counts, gains, weights = (torch.from_numpy(np.asarray(part)).to(device) for part in (data.counts, gains, weights))
    return _Rays(counts, gains, weights, data)


def _rays_of_step(data: Measurements, views: Int[np.ndarray, " view"], device: torch.device) -> _Rays:
    """Take some views of a scan, which a GPU keeps whole where it has room."""
    if device.type == "cpu":
        return _rays(data[views], device)
    if data not in _KEPT and 3 * data.counts.nbytes < KEPT_PART * torch.cuda.mem_get_info(device)[0]:
        _KEPT[data] = _rays(data, device)
    if data in _KEPT:
        return _KEPT[data].of_views(torch.from_numpy(views).to(device))
    return _rays(data[views], device)


_KEPT: "WeakKeyDictionary[Measurements, _Rays]" = WeakKeyDictionary()


def _portions(rays: _Rays) -> Iterator[slice]:
    """Split views into those whose images are held together."""
    views, *image = rays.counts.shape
    size = 1 if rays.counts.device.type == "cpu" else max(1, VALUES_AT_ONCE // max(int(np.prod(image)), 1))
    yield from (slice(first, min(first + size, views)) for first in range(0, views, size))


def _expected_counts(
    images: Float[Tensor, "view basis row column"], rays: _Rays
) -> Float[Tensor, "view channel row column"]:
    """Compute expected counts of line integrals."""
    lengths = bounded(images).movedim(1, -1).contiguous()
    if rays.scan.profile is not None:
        known = torch.from_numpy(rays.scan.profile).to(lengths).movedim(0, -1)
        lengths = torch.cat([lengths, known.expand(len(lengths), *known.shape)], dim=-1)
    return transmit(lengths, rays.scan.transmission).movedim(-1, 1) * rays.gains


def _summed(sums: Float[Tensor, " sum"], processes: Processes) -> Likelihood:
    """Divide sums over the views of all processes by their expected values."""
    processes.add_up([sums])
    (total, *squares), (least, *noise) = np.array(sums.tolist()).reshape(2, -1)
    found = np.divide(squares, noise, out=np.full(len(noise), np.nan), where=np.array(noise) > 0)
    return Likelihood(float(total / least) if least != 0 else 0.0, found)
