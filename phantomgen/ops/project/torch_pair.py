"""The projector pair for torch tensors: their device decides what computes; each direction is the other's gradient.

The gradient in the poses is computed by numba, and by plain torch for tensors on a GPU.
"""

from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Float32
from torch import Tensor

from spectra.errors import InputError, NotInstalledError


def forward(
    volume: Float[Tensor, "component z y x"],
    views: "Float[np.ndarray, 'view 4 3'] | Float[Tensor, 'view 4 3']",
    parallel: bool,
    spacing: Float[np.ndarray, " 3"],
    rows: int,
    columns: int,
) -> Float32[Tensor, "component view row column"]:
    """Compute line integrals of volumes.

    Parameters
    ----------
    volume : values of the voxels
    views : frames in voxels and in the order (z, y, x), as in `phantomgen.ops.project.project`; tensors may carry
        gradients
    parallel : whether rays are parallel
    spacing : size of a voxel (z, y, x) [mm]
    rows, columns : size of the panel

    Returns
    -------
    line integrals
    """
    return _Forward.apply(volume.float(), torch.as_tensor(views), parallel, spacing, rows, columns)  # type: ignore[return-value]


def backward(
    images: Float[Tensor, "component view row column"],
    views: "Float[np.ndarray, 'view 4 3'] | Float[Tensor, 'view 4 3']",
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
    return _Backward.apply(images.float(), torch.as_tensor(views), parallel, spacing, shape)  # type: ignore[return-value]


class _Forward(torch.autograd.Function):
    @staticmethod
    def forward(volume, views, parallel, spacing, rows, columns):
        return _compute("forward", volume, _array(views), parallel, spacing, rows, columns)

    @staticmethod
    def setup_context(ctx, inputs, output):
        volume, views, *ctx.rest = inputs
        ctx.save_for_backward(volume, views)

    @staticmethod
    def backward(ctx, *cotangents):
        (volume, views), (parallel, spacing, *_) = ctx.saved_tensors, ctx.rest
        by_volume = by_views = None
        if ctx.needs_input_grad[0]:
            by_volume = _Backward.apply(cotangents[0], views, parallel, spacing, tuple(volume.shape[1:]))
        if ctx.needs_input_grad[1]:
            by_views = _PoseGradient.apply(volume, cotangents[0], views, parallel, spacing)
        return by_volume, by_views, None, None, None, None


class _Backward(torch.autograd.Function):
    @staticmethod
    def forward(images, views, parallel, spacing, shape):
        return _compute("backward", images, _array(views), parallel, spacing, shape)

    @staticmethod
    def setup_context(ctx, inputs, output):
        images, views, *ctx.rest = inputs
        ctx.save_for_backward(images, views)

    @staticmethod
    def backward(ctx, *cotangents):
        (images, views), (parallel, spacing, _) = ctx.saved_tensors, ctx.rest
        by_images = by_views = None
        if ctx.needs_input_grad[0]:
            by_images = _Forward.apply(cotangents[0], views, parallel, spacing, *images.shape[2:])
        if ctx.needs_input_grad[1]:  # a transpose and its pair weigh the same pairs of pixel and voxel
            by_views = _PoseGradient.apply(cotangents[0], images, views, parallel, spacing)
        return by_images, by_views, None, None, None


class _PoseGradient(torch.autograd.Function):
    @staticmethod
    def forward(volume, images, views, parallel, spacing):
        if volume.device.type == "cpu":
            from phantomgen.ops.project import numpy_pair as arrays  # noqa: PLC0415

            found = arrays.pose_gradient(volume.numpy(), images.numpy(), _array(views), parallel, spacing)
            return torch.from_numpy(found).to(views)
        return pose_gradient_on_device(volume, images, views, parallel, spacing)

    @staticmethod
    def setup_context(ctx, inputs, output):
        pass

    @staticmethod
    def backward(ctx, *cotangents):
        raise InputError("second derivatives in the poses are not computed: use float64 tensors, which have them")


def pose_gradient_on_device(
    volume: Float[Tensor, "component z y x"],
    images: Float[Tensor, "component view row column"],
    views: Float[Tensor, "view 4 3"],
    parallel: bool,
    spacing: Float[np.ndarray, " 3"],
    most: int = 1 << 22,
) -> Float[Tensor, "view 4 3"]:
    """Compute the derivatives of ``(images * forward(volume, ...)).sum()`` in the views, by plain torch in float64.

    For devices without a kernel. A view is computed some rows at a time.

    Parameters
    ----------
    volume : values of the voxels
    images : weights of the pixels
    views, parallel, spacing : as in `forward`
    most : pixels x layers at once

    Returns
    -------
    derivatives [1/voxel]
    """
    from phantomgen.ops.project import differentiable  # noqa: PLC0415

    values, sizes = volume.detach().double(), torch.from_numpy(spacing).to(volume.device)
    rows, columns = images.shape[2:]
    together = max(1, most // (columns * max(volume.shape[1:])))
    found = torch.zeros(len(views), 4, 3, dtype=torch.float64, device=volume.device)
    for i, first in ((i, first) for i in range(len(views)) for first in range(0, rows, together)):
        with torch.enable_grad():
            frame = views[i : i + 1].detach().to(found).requires_grad_()
            part = frame.clone()
            part[:, 1] = frame[:, 1] + first * frame[:, 3]
            weights = images[:, i : i + 1, first : first + together].detach().double()
            sums = differentiable.forward(values, part, parallel, sizes, weights.shape[2], columns)
            found[i] += torch.autograd.grad((weights * sums).sum(), frame)[0][0]
    return found.to(views)


def _array(views: Tensor) -> np.ndarray:
    return np.ascontiguousarray(views.detach().cpu().double().numpy())


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
