"""The paper's loss (eq. 8): L1, structural dissimilarity and two total variations."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from recon.published_methods.paper.model import FactorisedGaussians, Units
from recon.published_methods.paper.projections import line_integrals
from recon.published_methods.paper.recipe import PaperRecipe
from recon.published_methods.paper.spectral_model import SpectralModel
from recon.published_methods.paper.ssim import ssim
from recon.published_methods.paper.variation import patch_of_channels, random_patch, total_variation

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
