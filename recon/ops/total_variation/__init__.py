"""Joint total variation of several volumes: its value, and the two steps of a primal-dual method.

TV(x) = sum over voxels of |W (D x)|, where D are the differences to the next voxel along z, y and x (0 at the far
border), each over the voxel's size relative to the smallest, W mixes the bases, and the norm is over bases and axes
together, which favours edges that coincide in all bases. TV(x) is the largest <p, W D x> over fields p with |p| <= 1.

References
----------
Rudin, Osher, Fatemi 1992, doi:10.1016/0167-2789(92)90242-F; jointly over channels: Blomgren & Chan 1998,
doi:10.1109/83.661180; the dual: Chambolle 2004, doi:10.1023/B:JMIV.0000011325.36760.1e.
"""

from typing import Any

import numpy as np
from jaxtyping import Float
from torch import Tensor

from phantomgen.geometry.voxel_grid import Grid
from recon.ops.pieces import run_in_pieces
from recon.ops.total_variation import cpu

SLAB = 4  # slices per piece of work

Array = Any  # an array, or a tensor on a GPU
Volumes = Float[np.ndarray, "basis z y x"]
Mixing = Float[np.ndarray, "basis basis"]


def total_variation(volumes: Volumes, mixing: Mixing, grid: Grid) -> float:
    """Compute the total variation of volumes.

    Parameters
    ----------
    volumes : one per basis
    mixing : W; matrices with the same W^T W give the same value
    grid : the voxels

    Returns
    -------
    TV(x), in the unit of the volumes times that of `mixing`
    """
    volumes, operator = _plain(volumes), _operator(mixing, grid)
    parts = np.zeros(len(volumes[0]))

    def slab(first: int, last: int) -> None:
        room = np.empty((2, 3, *volumes.shape[::3]), np.float32)
        cpu.total_variation(volumes, operator, first, last, room, parts)

    run_in_pieces(slab, len(parts), SLAB)
    return float(parts.sum())


def ascend(
    field: Float[Array, "axis basis z y x"],
    volumes: Float[Array, "basis z y x"],
    mixing: Mixing,
    grid: Grid,
    steps: Float[Array, "z y x"],
    radii: Float[Array, "z y x"],
) -> None:
    """Move a field, in place, by `steps` times W D x, and project it onto the ball of each voxel's radius around 0.

    Parameters
    ----------
    field : p of every voxel, float32; arrays, or tensors on a GPU
    volumes, mixing, grid : x, W and the voxels
    steps : length of the step of each voxel
    radii : largest |p| of each voxel, which is the weight of its differences in the total variation
    """
    if isinstance(field, Tensor):
        from recon.ops.total_variation import gpu  # noqa: PLC0415 - Triton only where there is a GPU

        gpu.ascend(field, volumes.contiguous(), mixing, _scales(grid), steps.contiguous(), radii.contiguous())
        return
    volumes, operator, steps, radii = _plain(volumes), _operator(mixing, grid), _plain(steps), _plain(radii)

    def slab(first: int, last: int) -> None:
        room = np.empty((2, 3, *volumes.shape[::3]), np.float32)
        cpu.ascend(field, volumes, operator, steps, radii, first, last, room)

    run_in_pieces(slab, field.shape[2], SLAB)


def gradient(field: Float[Array, "axis basis z y x"], mixing: Mixing, grid: Grid) -> Float[Array, "basis z y x"]:
    """Compute D^T W^T p, the transpose of what `ascend` adds for steps of 1.

    Parameters
    ----------
    field : p of every voxel, float32; an array, or a tensor on a GPU
    mixing, grid : W and the voxels

    Returns
    -------
    volumes, float32
    """
    if isinstance(field, Tensor):
        from recon.ops.total_variation import gpu  # noqa: PLC0415 - Triton only where there is a GPU

        return gpu.gradient(field, mixing, _scales(grid))
    operator = _operator(mixing, grid)
    out = np.empty(field.shape[1:], np.float32)

    def slab(first: int, last: int) -> None:
        room = np.empty(out.shape[::3], np.float32)
        cpu.gradient(field, operator, first, last, room, out)

    run_in_pieces(slab, field.shape[2], SLAB)
    return out


def neighbour_sums(values: Float[np.ndarray, "z y x"], grid: Grid) -> Float[np.ndarray, "z y x"]:
    """Bound the weighted norm of D^T p from above: ``sum_j values_j |(D^T p)_j|^2 <= sum_j out_j |p_j|^2``.

    Parameters
    ----------
    values : weight of each voxel
    grid : the voxels

    Returns
    -------
    weights of the bound, one per voxel
    """
    scales = _scales(grid)
    worst = values.copy()
    for axis in range(3):
        inner = [slice(None)] * 3
        outer = [slice(None)] * 3
        inner[axis], outer[axis] = slice(None, -1), slice(1, None)
        worst[tuple(inner)] = np.maximum(worst[tuple(inner)], values[tuple(outer)])
    return (values + worst) * np.float32(2 * (scales**2).sum())


def _operator(mixing: Mixing, grid: Grid) -> cpu.MixedDifferences:
    return cpu.MixedDifferences(_plain(mixing), _scales(grid))


def _scales(grid: Grid) -> Float[np.ndarray, " axis"]:
    """Compute the factors of the differences along z, y and x."""
    return (min(grid.spacing) / np.array(grid.spacing)).astype(np.float32)


def _plain(values: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    return np.ascontiguousarray(values, np.float32)
