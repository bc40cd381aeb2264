"""Total variation as its formula reads, in float64 torch."""

import torch
from jaxtyping import Float
from torch import Tensor


def differences(volumes: Float[Tensor, "basis z y x"], scales: list[float]) -> Float[Tensor, "axis basis z y x"]:
    """Differences to the next voxel along z, y and x; 0 at the far border."""
    out = []
    for axis, scale in enumerate(scales):
        step = torch.diff(volumes, dim=1 + axis)
        missing = torch.zeros_like(volumes.narrow(1 + axis, 0, 1))
        out.append(scale * torch.cat([step, missing], dim=1 + axis))
    return torch.stack(out)


def total_variation(
    volumes: Float[Tensor, "basis z y x"], mixing: Float[Tensor, "basis basis"], scales: list[float]
) -> Float[Tensor, ""]:
    """Sum over voxels of the norm, over axes and mixed bases."""
    mixed = torch.einsum("mn,anzyx->amzyx", mixing, differences(volumes, scales))
    return mixed.square().sum(dim=(0, 1)).sqrt().sum()
