"""Total variation: of projections of the bases, and of a random piece of the channels' volumes."""

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from phantomgen.geometry.voxel_grid import Grid
from recon.ops.voxelize import CUTOFF, voxelize_tensor


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
