"""Line integrals of voxel volumes, and the exact transpose: a matched pair for any panel, cone or parallel.

Of the projectors that were compared (`benchmarks/operators/voxel_projector.py`), this one errs least per time: where
pixels are no wider than voxels it is Joseph's, and wider pixels are averaged over their area. Arrays give arrays. Torch
tensors give tensors on their device, a GPU included, and carry gradients, those in the poses included where frames are
tensors.
"""

import sys
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from jaxtyping import Float, Float32

from phantomgen.geometry.curved_panel import join_modules, split_modules
from phantomgen.geometry.voxel_grid import Grid
from spectra.errors import InputError

if TYPE_CHECKING:
    from torch import Tensor

    Array = TypeVar("Array", np.ndarray, Tensor)
else:
    Array = Any  # anything with a shape and a dtype; torch is imported where tensors come


def project(
    volume: Float[Array, "component z y x"],
    grid: Grid,
    frames: "Float[np.ndarray | Tensor, 'view *module 4 3']",
    rows: int,
    columns: int,
    parallel: bool = False,
) -> Float32[Array, "component view row column"]:
    """Compute line integrals of several volumes at once.

    Parameters
    ----------
    volume : values of the voxels, such as [1/mm]; there is nothing outside of the grid
    grid : the voxels
    frames : per view, as `Geometry.ray_frames` gives them, of rays ``frame[0] + t (frame[1] + u frame[2] + v
        frame[3])`` through column u and row v [mm]; if `parallel`, of rays ``frame[1] + u frame[2] + v frame[3] + t
        frame[0]``. Rays begin at t = 0, the source, and end at t = 1, the panel. With a tensor for the volume they may
        be a tensor too, which then has gradients, of first order; (view, module, 4, 3) for modules side by side, as
        `phantomgen.geometry.curved_panel.module_frames` gives them
    rows, columns : size of the panel
    parallel : whether rays are parallel

    Returns
    -------
    line integrals; without unit for values in 1/mm

    Raises
    ------
    InputError
        When the volume does not fit the grid, or frames are not four finite vectors per view.
    """
    if frames.ndim == 4:
        modules = frames.shape[1]
        images = project(volume, grid, frames.reshape(-1, 4, 3), rows, columns // modules, parallel)
        return join_modules(images, modules, views=1)
    if volume.shape[1:] != grid.shape:
        shape = tuple(volume.shape)
        raise InputError(f"a volume on a grid of shape {grid.shape} must end with these axes, got {shape}")
    views, spacing = _in_voxels(frames, grid, parallel)
    return _implementation(volume).forward(volume, views, bool(parallel), spacing, rows, columns)


def project_transpose(
    images: Float[Array, "component view row column"],
    grid: Grid,
    frames: "Float[np.ndarray | Tensor, 'view *module 4 3']",
    parallel: bool = False,
) -> Float32[Array, "component z y x"]:
    """Sum all pixels, each times the weight that `project` gives to a voxel.

    Parameters
    ----------
    images : values of the pixels
    grid, frames, parallel : as in `project`

    Returns
    -------
    volumes; weights have the unit mm

    Raises
    ------
    InputError
        When the images do not fit the views, or frames are not four finite vectors per view.
    """
    if images.ndim == 4 and images.shape[1] == len(frames) and frames.ndim == 4:
        parts = split_modules(images, frames.shape[1], views=1)
        return project_transpose(parts, grid, frames.reshape(-1, 4, 3), parallel)
    if images.ndim != 4 or images.shape[1] != len(frames):
        shape = tuple(images.shape)
        raise InputError(f"images of {len(frames)} views must be (component, view, row, column), got {shape}")
    views, spacing = _in_voxels(frames, grid, parallel)
    return _implementation(images).backward(images, views, bool(parallel), spacing, grid.shape)


def pose_gradient(
    volume: Float[np.ndarray, "component z y x"],
    images: Float[np.ndarray, "component view row column"],
    grid: Grid,
    frames: Float[np.ndarray, "view 4 3"],
    parallel: bool = False,
) -> Float[np.ndarray, "view 4 3"]:
    """Compute the derivatives of ``(images * project(volume, ...)).sum()`` in the frames, in float64 on the CPU.

    Parameters
    ----------
    volume : values of the voxels, as in `project`
    images : weights of the pixels
    grid, frames, parallel : as in `project`

    Returns
    -------
    derivatives in each vector of each frame [1/mm]; jumps of the projector where rays change their main axis are left
    out

    Raises
    ------
    InputError
        When arrays do not fit each other, or frames are not four finite vectors per view.
    """
    expected = len(volume), len(frames)
    if volume.shape[1:] != grid.shape or images.ndim != 4 or images.shape[:2] != expected:
        shapes = f"{volume.shape} and {images.shape}"
        raise InputError(f"needs a volume on the grid {grid.shape} and images of {expected[1]} views, got {shapes}")
    from phantomgen.ops.project import numpy_pair as home  # noqa: PLC0415

    views, spacing = _in_voxels(frames, grid, parallel)
    return home.pose_gradient(volume, images, views, bool(parallel), spacing)[:, :, ::-1] / spacing[::-1]


def values_of_averages(volume: Float[np.ndarray, "... z y x"]) -> Float[np.ndarray, "... z y x"]:
    """Compute values at the centres of voxels between which linear interpolation has given averages over voxels.

    Interpolated as they are, averages are blurred by the voxel twice: when they were taken, and between voxels. The
    average of a linear interpolant over voxel i is v_i + (v_(i-1) - 2 v_i + v_(i+1)) / 8 along each axis; this is its
    inverse to first order. `project` errs less of what was averaged (`benchmarks/peers/simulators.py`), but at edges
    values overshoot, also below 0.

    Parameters
    ----------
    volume : averages over voxels

    Returns
    -------
    values at the centres
    """
    bends = np.zeros_like(volume)
    for axis in (-3, -2, -1):
        line = np.moveaxis(volume, axis, -1)
        bend = np.moveaxis(bends, axis, -1)
        bend -= 2 * line
        bend[..., 1:] += line[..., :-1]
        bend[..., :-1] += line[..., 1:]
    return volume - bends / 8


def _implementation(values: object) -> Any:
    """Module that computes with such values; torch is not imported here, as it is where there are tensors."""
    if _is_tensor(values):
        from phantomgen.ops.project import torch_pair as home  # noqa: PLC0415
    else:
        from phantomgen.ops.project import numpy_pair as home  # noqa: PLC0415 - numba is only worth its import where used
    return home


def _in_voxels(frames: Any, grid: Grid, parallel: bool) -> tuple[Any, np.ndarray]:
    """Frames in voxels and in the order (z, y, x), and sizes of voxels [mm]; of tensors with their gradients."""
    tensor = _is_tensor(frames)
    frames = frames.double() if tensor else np.asarray(frames, dtype=np.float64)
    if frames.ndim != 3 or tuple(frames.shape[1:]) != (4, 3) or not bool((abs(frames) < np.inf).all()):
        raise InputError(f"frames must be four finite vectors per view, (view, 4, 3), got {tuple(frames.shape)}")
    spacing, shift = np.array(grid.spacing, dtype=np.float64), np.zeros((4, 3))
    shift[int(parallel)] = grid.origin[::-1]
    if tensor:
        return (frames - frames.new_tensor(shift)).flip(-1) / frames.new_tensor(spacing), spacing
    return np.ascontiguousarray((frames - shift)[:, :, ::-1] / spacing), spacing


def _is_tensor(values: object) -> bool:
    torch = sys.modules.get("torch")
    return torch is not None and isinstance(values, torch.Tensor)
