"""Total variation by its formula, in float64 torch."""

import torch
from jaxtyping import Float
from torch import Tensor


def differences(volumes: Float[Tensor, "basis z y x"], scales: list[float]) -> Float[Tensor, "axis basis z y x"]:
    """Compute differences to the next voxel along z, y and x; 0 at the far border.

    Parameters
    ----------
    volumes : one per basis
    scales : factors of the differences along z, y and x

    Returns
    -------
    differences
    """
    out = []
    for axis, scale in enumerate(scales):
        step = torch.diff(volumes, dim=1 + axis)
        missing = torch.zeros_like(volumes.narrow(1 + axis, 0, 1))
        out.append(scale * torch.cat([step, missing], dim=1 + axis))
    return torch.stack(out)


def total_variation(
    volumes: Float[Tensor, "basis z y x"], mixing: Float[Tensor, "basis basis"], scales: list[float]
) -> Float[Tensor, ""]:
    """Sum the norm of the mixed differences, over axes and bases, over all voxels.

    Parameters
    ----------
    volumes : one per basis
    mixing : W
    scales : factors of the differences along z, y and x

    Returns
    -------
    TV(x)
    """
    mixed = torch.einsum("mn,anzyx->amzyx", mixing, differences(volumes, scales))
    return mixed.square().sum(dim=(0, 1)).sqrt().sum()
