"""The projector pair for torch tensors: their device decides what computes; each direction is the other's gradient."""

from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Float32
from torch import Tensor

from spectra.errors import InputError, NotInstalledError


def forward(
    volume: Float[Tensor, "component z y x"],
    views: Float[np.ndarray, "view 4 3"],
    parallel: bool,
    spacing: Float[np.ndarray, " 3"],
    rows: int,
    columns: int,
) -> Float32[Tensor, "component view row column"]:
    """Compute line integrals of volumes.

    Parameters
    ----------
    volume : values of the voxels
    views : frames in voxels and in the order (z, y, x), as in `phantomgen.ops.project.project`
    parallel : whether rays are parallel
    spacing : size of a voxel (z, y, x) [mm]
    rows, columns : size of the panel

    Returns
    -------
    line integrals
    """
    return _Forward.apply(volume.float(), views, parallel, spacing, rows, columns)  # type: ignore[return-value]


def backward(
    images: Float[Tensor, "component view row column"],
    views: Float[np.ndarray, "view 4 3"],
    parallel: bool,
    spacing: Float[np.ndarray, " 3"],
    shape: tuple[int, int, int],
) -> Float32[Tensor, "component z y x"]:
    """Apply the transpose of `forward`.

    Parameters
    ----------
    images : values of the pixels
    views, parallel, spacing : as in `forward`
    shape : number of voxels along (z, y, x)

    Returns
    -------
    volumes
    """
    return _Backward.apply(images.float(), views, parallel, spacing, shape)  # type: ignore[return-value]


class _Forward(torch.autograd.Function):
    @staticmethod
    def forward(ctx, volume, views, parallel, spacing, rows, columns):
        ctx.rest = views, parallel, spacing, tuple(volume.shape[1:])
        return _compute("forward", volume, views, parallel, spacing, rows, columns)

    @staticmethod
    def backward(ctx, *cotangents):
        return _Backward.apply(cotangents[0], *ctx.rest), None, None, None, None, None


class _Backward(torch.autograd.Function):
    @staticmethod
    def forward(ctx, images, views, parallel, spacing, shape):
        ctx.rest = views, parallel, spacing, *images.shape[2:]
        return _compute("backward", images, views, parallel, spacing, shape)

    @staticmethod
    def backward(ctx, *cotangents):
        return _Forward.apply(cotangents[0], *ctx.rest), None, None, None, None


def _compute(direction: str, values: Tensor, *rest: Any) -> Tensor:
    """Call the function of this name of the module for the device of a tensor."""
    if values.device.type == "cpu":
        from phantomgen.ops.project import numpy_pair as arrays  # noqa: PLC0415 - only what the device needs

        return torch.from_numpy(getattr(arrays, direction)(values.numpy(), *rest))
    if values.device.type != "cuda":
        raise InputError(f"voxels are projected on the devices cpu and cuda, but the tensor is on {values.device}")
    try:
        from phantomgen.ops.project import gpu  # noqa: PLC0415
    except ModuleNotFoundError as problem:
        if problem.name != "triton":
            raise
        raise NotInstalledError("voxels of a tensor on a GPU are projected by Triton: pip install triton") from problem
    with torch.cuda.device_of(values):
        return getattr(gpu, direction)(values.contiguous(), *rest)
