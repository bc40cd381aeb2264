"""The paper's loss (eq. 8): L1, structural dissimilarity and two total variations."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from recon.ops.voxelize import CUTOFF, voxelize_tensor
from recon.published_methods.paper.model import FactorisedGaussians, Units
from recon.published_methods.paper.projections import line_integrals
from recon.published_methods.paper.recipe import PaperRecipe
from recon.published_methods.paper.spectral_model import SpectralModel

Images = Float[Tensor, "view channel row column"]
Seen = Bool[Tensor, "view channel row column"]


@dataclass(frozen=True, eq=False)
class Rendered:
    """A loss and what it was computed from.

    Parameters
    ----------
    loss : eq. 8
    log_projections : what the model predicts
    nudge : added to the centres before they were projected; its gradient is that of the projector alone
    """

    loss: Float[Tensor, ""]
    log_projections: Images
    nudge: Float[Tensor, "gaussian 3"]


def data_loss(predicted: Images, measured: Images, seen: Seen, dssim: float) -> Float[Tensor, ""]:
    """(1 - dssim) L1 + dssim (1 - SSIM), each a mean over pixels, summed over channels.

    Where a pixel was not measured the prediction stands in for it: it adds nothing, and its neighbours are not misled.
    """
    measured = torch.where(seen, measured, predicted.detach())
    loss = (1 - dssim) * (predicted - measured).abs().mean(dim=(0, 2, 3)).sum()
    return loss + dssim * (1 - ssim(predicted, measured)).mean(dim=(0, 2, 3)).sum() if dssim else loss


def total_loss(
    model: FactorisedGaussians,
    spectral: SpectralModel,
    measured: Images,
    seen: Seen,
    geometry: Geometry,
    grid: Grid,
    units: Units,
    recipe: PaperRecipe,
    rng: np.random.Generator,
) -> Rendered:
    """Eq. 8 for one view and a random piece of the volume.

    Images are divided by `Units.line_integral` and volumes by `Units.density` first: R2-Gaussian's weights, and the
    constants of structural similarity, presume densities up to 1 in a box of edge 2.
    """
    nudge = torch.zeros_like(model.centres, requires_grad=True)
    shape = (model.log_scales(units), model.quaternions)
    coefficients = model.coefficients(units)
    projector = "local-affine" if recipe.uses("local-affine") else "exact"
    images = line_integrals(model.centres + nudge, *shape, coefficients, geometry, projector)
    predicted = spectral.log_projections(images)
    scale = 1 / units.line_integral
    loss = data_loss(predicted * scale, measured * scale, seen, recipe.dssim if recipe.uses("dssim") else 0.0)
    if recipe.uses("tv") and recipe.uses("image-tv"):
        loss = loss + recipe.image_tv * total_variation(images[0] * scale).sum()
    if recipe.uses("tv") and recipe.uses("volume-tv"):
        patch = random_patch(grid, recipe.patch, rng)
        volumes = patch_of_channels(model.centres, *shape, coefficients, spectral.channel_means(), patch)
        loss = loss + recipe.volume_tv * total_variation(volumes / units.density).mean()
    return Rendered(loss, predicted.detach(), nudge)


WINDOW, SIGMA = 11, 1.5
C1, C2 = 0.01**2, 0.03**2  # for images between 0 and 1


def ssim(
    image: Float[Tensor, "view channel row column"], other: Float[Tensor, "view channel row column"]
) -> Float[Tensor, "view channel row column"]:
    """Map of structural similarity: a Gaussian window of 11 x 11 pixels and standard deviation 1.5, zeros outside.

    References
    ----------
    Wang, Bovik, Sheikh, Simoncelli 2004, doi:10.1109/TIP.2003.819861, eq. 13, for a data range of 1.
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
    """Mean absolute forward difference of each image, summed over its axes (anisotropic); 0 along an axis of one."""
    total = images.new_zeros(len(images))
    for axis in range(1, images.ndim):
        if images.shape[axis] > 1:
            total = total + images.diff(dim=axis).abs().flatten(1).mean(dim=1)
    return total


def random_patch(grid: Grid, edge: int, rng: np.random.Generator) -> Grid:
    """A cube of at most `edge` voxels along each axis, anywhere inside a grid."""
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
    """Attenuation that each channel sees in a patch [1/mm]: the bases' volumes, weighted by the channel's means.

    Only Gaussians that may reach into the patch are looked at.
    """
    near = _near(centres.detach(), log_scales.detach(), patch)
    bases = voxelize_tensor(centres[near], log_scales[near], quaternions[near], coefficients[near], patch)
    return torch.einsum("cm,mzyx->czyx", means, bases)


def _near(
    centres: Float[Tensor, "gaussian 3"], log_scales: Float[Tensor, "gaussian 3"], patch: Grid
) -> Int[Tensor, " near"]:
    """Indices of the Gaussians whose ball of `CUTOFF` standard deviations, and a voxel or two, meets the patch."""
    spacing = torch.tensor(patch.spacing[::-1])
    reach = CUTOFF * torch.exp(log_scales.max(dim=1).values)[:, None] + spacing * (1 + CUTOFF / 12**0.5)
    low = torch.tensor(patch.origin[::-1])
    high = low + spacing * (torch.tensor(patch.shape[::-1]) - 1)
    return torch.nonzero(((centres > low - reach) & (centres < high + reach)).all(dim=1))[:, 0]
