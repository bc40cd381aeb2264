"""The paper's loss (eq. 8): L1, structural dissimilarity and two total variations."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from phantomgen.geometry.voxel_grid import Grid
from recon.ops.voxelize import CUTOFF, voxelize_tensor
from recon.published_methods.paper.model import FactorisedGaussians, Units
from recon.published_methods.paper.projections import Projections, line_integrals
from recon.published_methods.paper.recipe import PaperRecipe
from recon.published_methods.paper.spectral_model import SpectralModel

Images = Float[Tensor, "view channel row column"]
Seen = Bool[Tensor, "view channel row column"]

WINDOW, SIGMA = 11, 1.5  # pixels; edge and standard deviation of the window; Wang et al. 2004
C1, C2 = 0.01**2, 0.03**2  # no unit; constants of structural similarity for a data range of 1; Wang et al. 2004


@dataclass(frozen=True, eq=False)
class Rendered:
    """Loss of one view and the prediction from which it was computed.

    Parameters
    ----------
    loss : loss (eq. 8)
    log_projections : predicted log projections
    offset : zeros that were added to the centres for the projection; their gradient is that of the projections alone
    """

    loss: Float[Tensor, ""]
    log_projections: Images
    offset: Float[Tensor, "gaussian 3"]


def data_loss(predicted: Images, measured: Images, seen: Seen, dssim: float) -> Float[Tensor, ""]:
    """Compute the loss of images: (1 - dssim) L1 + dssim (1 - SSIM), means over pixels, summed over channels.

    Parameters
    ----------
    predicted, measured : images, with values between 0 and about 1
    seen : pixels that were measured
    dssim : weight of structural dissimilarity

    Returns
    -------
    loss, differentiable in `predicted`. Pixels that were not measured take the predicted value, so that they add
    nothing and do not disturb the structural similarity of their neighbours
    """
    measured = torch.where(seen, measured, predicted.detach())
    loss = (1 - dssim) * (predicted - measured).abs().mean(dim=(0, 2, 3)).sum()
    return loss + dssim * (1 - ssim(predicted, measured)).mean(dim=(0, 2, 3)).sum() if dssim else loss


def total_loss(
    model: FactorisedGaussians,
    spectral: SpectralModel,
    view: Projections,
    grid: Grid,
    units: Units,
    recipe: PaperRecipe,
    rng: np.random.Generator,
) -> Rendered:
    """Compute the loss of one view and a random patch of the volume (eq. 8).

    Parameters
    ----------
    model : Gaussians
    spectral : model of log projections
    view : measured projections of one view
    grid : grid of the volume
    units : units of the scene
    recipe : weights and components
    rng : random numbers for the position of the patch

    Returns
    -------
    loss and predicted log projections

    Notes
    -----
    Images are divided by `Units.line_integral` and volumes by `Units.density` first: R2-Gaussian's weights, and the
    constants of structural similarity, assume densities up to 1 in a box of edge 2.
    """
    offset = torch.zeros_like(model.centres, requires_grad=True)
    shape = (model.log_scales(units), model.quaternions)
    coefficients = model.coefficients(units)
    projector = "local-affine" if recipe.uses("local-affine") else "exact"
    images = line_integrals(model.centres + offset, *shape, coefficients, view.geometry, projector)
    predicted = spectral.log_projections(images)
    scale, dssim = 1 / units.line_integral, recipe.dssim if recipe.uses("dssim") else 0.0
    loss = data_loss(predicted * scale, view.log() * scale, view.seen, dssim)
    if recipe.uses("tv") and recipe.uses("image-tv"):
        loss = loss + recipe.image_tv * total_variation(images[0] * scale).sum()
    if recipe.uses("tv") and recipe.uses("volume-tv"):
        patch = random_patch(grid, recipe.patch, rng)
        volumes = patch_of_channels(model.centres, *shape, coefficients, spectral.channel_means(), patch)
        loss = loss + recipe.volume_tv * total_variation(volumes / units.density).mean()
    return Rendered(loss, predicted.detach(), offset)


def ssim(image: Images, other: Images) -> Images:
    """Compute the structural similarity of two images at each pixel.

    Parameters
    ----------
    image, other : images with a data range of 1

    Returns
    -------
    structural similarity, from a Gaussian window of 11 x 11 pixels and standard deviation 1.5, with zeros outside

    References
    ----------
    Wang, Bovik, Sheikh, Simoncelli 2004, doi:10.1109/TIP.2003.819861, eq. 13.
    """
    stack = torch.cat([image, other, image * image, other * other, image * other], dim=1)
    mean, other_mean, square, other_square, product = _blur(stack).chunk(5, dim=1)
    variance, other_variance = square - mean**2, other_square - other_mean**2
    covariance = product - mean * other_mean
    alike = (2 * mean * other_mean + C1) * (2 * covariance + C2)
    return alike / ((mean**2 + other_mean**2 + C1) * (variance + other_variance + C2))


def _blur(images: Float[Tensor, "view image row column"]) -> Float[Tensor, "view image row column"]:
    """Convolution with the window, first along rows, then along columns."""
    offsets = torch.arange(WINDOW, dtype=images.dtype) - WINDOW // 2
    window = torch.exp(-(offsets**2) / (2 * SIGMA**2))
    window = window / window.sum()
    views, count, rows, columns = images.shape
    flat = images.reshape(views * count, 1, rows, columns)
    flat = torch.nn.functional.conv2d(flat, window.view(1, 1, 1, -1), padding=(0, WINDOW // 2))
    flat = torch.nn.functional.conv2d(flat, window.view(1, 1, -1, 1), padding=(WINDOW // 2, 0))
    return flat.reshape(images.shape)


def total_variation(images: Float[Tensor, "image *axes"]) -> Float[Tensor, " image"]:
    """Compute the anisotropic total variation: the mean absolute forward difference, summed over axes.

    Parameters
    ----------
    images : images or volumes

    Returns
    -------
    total variation of each; an axis of length 1 adds 0
    """
    total = images.new_zeros(len(images))
    for axis in range(1, images.ndim):
        if images.shape[axis] > 1:
            total = total + images.diff(dim=axis).abs().flatten(1).mean(dim=1)
    return total


def random_patch(grid: Grid, edge: int, rng: np.random.Generator) -> Grid:
    """Choose a sub-volume at random.

    Parameters
    ----------
    grid : grid of the volume
    edge : number of voxels along each axis, or that of the grid where it is smaller
    rng : random numbers

    Returns
    -------
    grid of the sub-volume
    """
    shape = [min(edge, n) for n in grid.shape]
    first = [int(rng.integers(0, n - size + 1)) for n, size in zip(grid.shape, shape, strict=True)]
    origin = [o + f * s for o, f, s in zip(grid.origin, first, grid.spacing, strict=True)]
    return Grid(tuple(shape), grid.spacing, tuple(origin))  # type: ignore[arg-type]


def patch_of_channels(
    centres: Float[Tensor, "gaussian 3"],
    log_scales: Float[Tensor, "gaussian 3"],
    quaternions: Float[Tensor, "gaussian 4"],
    coefficients: Float[Tensor, "gaussian basis"],
    means: Float[Tensor, "channel basis"],
    patch: Grid,
) -> Float[Tensor, "channel z y x"]:
    """Compute the attenuation of each channel in a patch from the Gaussians that reach into it.

    Parameters
    ----------
    centres : centres (x, y, z) [mm]
    log_scales : logarithm of the standard deviations [log mm]
    quaternions : orientation (w, x, y, z)
    coefficients : coefficients of the bases [1/mm]
    means : mean of each basis function in each channel
    patch : grid of the patch

    Returns
    -------
    attenuation [1/mm], differentiable in the parameters of the Gaussians
    """
    near = _near(centres.detach(), log_scales.detach(), patch)
    bases = voxelize_tensor(centres[near], log_scales[near], quaternions[near], coefficients[near], patch)
    return torch.einsum("cm,mzyx->czyx", means, bases)


def _near(
    centres: Float[Tensor, "gaussian 3"], log_scales: Float[Tensor, "gaussian 3"], patch: Grid
) -> Int[Tensor, " near"]:
    """Indices of the Gaussians whose sphere of `CUTOFF` standard deviations, and one or two voxels, meets the patch."""
    spacing = torch.tensor(patch.spacing[::-1])
    reach = CUTOFF * torch.exp(log_scales.max(dim=1).values)[:, None] + spacing * (1 + CUTOFF / 12**0.5)
    low = torch.tensor(patch.origin[::-1])
    high = low + spacing * (torch.tensor(patch.shape[::-1]) - 1)
    return torch.nonzero(((centres > low - reach) & (centres < high + reach)).all(dim=1))[:, 0]
