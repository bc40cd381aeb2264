"""Volumes of divided Gaussians, each voxel holding its mean, differentiable."""

import itertools
import math

import numpy as np
import torch
from jaxtyping import Float, Int64
from torch import Tensor

from phantomgen.geometry.voxel_grid import Grid
from phantomgen.ops.simd import WIDTH
from recon.ops.interface import cpu_voxels
from recon.ops.interface.arrays import DividedTensors
from recon.ops.interface.voxel_table import SUMS
from recon.ops.pieces import run_all
from recon.ops.rasterize.footprints import whitening

CHUNK = 256  # Gaussians per piece of work
SLAB = 4  # slices per piece of work
WAVES = [k for k in itertools.product((-1.0, 0.0, 1.0), repeat=3) if k > (0.0, 0.0, 0.0)]  # per voxel; half of them
FARTHEST = 2.0**22  # voxels from the grid's corner


def voxelize_divided(
    gaussians: DividedTensors,
    grid: Grid,
    cutoff: float = 4.2,
) -> Float[Tensor, "basis z y x"]:
    """Compute the mean of each basis in each voxel.

    Parameters
    ----------
    gaussians : the Gaussians
    grid : voxels
    cutoff : where a Gaussian ends [standard deviations]

    Returns
    -------
    means, float32, differentiable once in all arrays of the Gaussians [1/mm]

    Notes
    -----
    A voxel is taken as a Gaussian of its variance V. The part of a Gaussian of covariance C in a voxel then has its
    centre of mass at C (C + V)^-1 times the voxel's offset, and the mean of the plane's transition is as for a pixel.
    Errors are below 0.01 of the difference between the sides in voxels that the plane crosses.
    """
    numbers, voxels, halves = _table(gaussians.exact(), grid, cutoff)
    below, above = gaussians.below, gaussians.above
    return _Volume.apply(numbers, voxels, halves, below, above - below, grid.shape, cutoff)  # type: ignore[return-value]


def _table(
    gaussians: DividedTensors, grid: Grid, cutoff: float
) -> tuple[Float[Tensor, "gaussian 14"], Int64[Tensor, "gaussian 3"], Float[Tensor, "gaussian 2"]]:
    """Numbers of `recon.ops.interface.voxel_table`, the voxels of the centres, and half the extents along z and y."""
    centres, log_scales, quaternions, planes = gaussians[:4]
    spacing = torch.tensor(grid.spacing[::-1], dtype=centres.dtype)
    origin = torch.tensor(grid.origin[::-1], dtype=centres.dtype)
    matrices = whitening(log_scales, quaternions) * spacing  # from voxels to standard deviations
    one = torch.eye(3, dtype=centres.dtype)
    inverse = torch.linalg.inv(matrices)
    narrow = inverse @ inverse.mT
    wide = narrow + one / 12
    precision = torch.linalg.inv(wide)
    upper = torch.linalg.cholesky(precision, upper=True)
    place = (centres - origin) / spacing
    voxel = torch.floor(place.detach() + 0.5).clamp(-FARTHEST, FARTHEST)
    x = place - voxel
    # A C (C + V)^-1 is the change of the whitened mean position with the voxel's offset, V - V (C + V)^-1 V its spread
    slope = (matrices @ narrow @ precision)[:, 2]
    across = matrices[:, 2]
    left = (across @ one / 12 * across).sum(-1) - torch.einsum("ni,nij,nj->n", across, precision, across) / 144
    root = torch.sqrt(planes[:, 1] ** 2 + left)
    amplitude = torch.sqrt(torch.linalg.det(narrow) * torch.linalg.det(precision)) / _lattice_mass(x, wide)
    entries = [upper[:, i, j] for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))]
    numbers = torch.stack([*x.T, *entries, amplitude, -planes[:, 0] / root, *(slope / root[:, None]).T], 1)
    with torch.no_grad():
        halves = cutoff * torch.stack([torch.sqrt(wide[:, 2, 2]), 1 / upper[:, 1, 1]], 1)
    return numbers, voxel.long(), halves


def _lattice_mass(x: Tensor, wide: Tensor) -> Tensor:
    """Sum over all voxels of densities of unit mass; see `recon.ops.rasterize.reference.lattice_mass`."""
    waves = torch.tensor(WAVES, dtype=x.dtype)
    decay = torch.exp(-2 * math.pi**2 * ((waves @ wide) * waves).sum(dim=2))
    return 1 + 2 * (decay * torch.cos(2 * math.pi * x @ waves.T)).sum(dim=1)


class _Volume(torch.autograd.Function):
    @staticmethod
    def forward(ctx, numbers, voxels, halves, below, step, shape, cutoff):
        table, extents = (part.detach().float().contiguous().numpy() for part in (numbers, halves))
        places = voxels.numpy()
        low, high = (part.detach().float().contiguous().numpy() for part in (below, step))
        bases, (slices, rows, columns) = (0,) * low.shape[1], shape
        volume = np.zeros((len(bases), slices, rows, columns + WIDTH), np.float32)

        def fill(first: int) -> None:
            last = min(first + SLAB, slices)
            cpu_voxels.fill(bases, table, places, extents, low, high, cutoff, columns, first, last, volume)

        run_all(fill, range(0, slices, SLAB))
        ctx.arrays, ctx.cutoff, ctx.numbers, ctx.dtype = (
            (table, places, extents, low, high),
            cutoff,
            numbers.detach(),
            below.dtype,
        )
        return torch.from_numpy(volume[..., :columns])

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, *cotangents):
        (table, places, extents, low, high), volume = ctx.arrays, cotangents[0].detach().numpy()
        bases, columns, n = (0,) * low.shape[1], volume.shape[3], len(low)
        padded = np.zeros((*volume.shape[:3], columns + WIDTH), np.float32)
        padded[..., :columns] = volume
        sums, to_low, to_high = np.zeros((n, SUMS)), np.zeros(low.shape), np.zeros(low.shape)

        def gather(first: int) -> None:
            last = min(first + CHUNK, n)
            cpu_voxels.backward(
                bases, table, places, extents, low, high, padded, ctx.cutoff, columns, first, last, sums, to_low,
                to_high,
            )  # fmt: skip

        run_all(gather, range(0, n, CHUNK))
        to_numbers = _to_numbers(ctx.numbers, torch.from_numpy(sums))
        to_below, to_step = (torch.from_numpy(part).to(ctx.dtype) for part in (to_low, to_high))
        return to_numbers, None, None, to_below, to_step, None, None


def _to_numbers(
    numbers: Float[Tensor, "gaussian 14"], sums: Float[Tensor, "gaussian 14"]
) -> Float[Tensor, "gaussian 14"]:
    """Gradient in each number from the sums over voxels (see `recon.ops.interface.cpu_voxels.backward`)."""
    w, wx, wy, wz, wxx, wxy, wxz, wyy, wyz, wzz, t, tx, ty, tz = sums.unbind(1)
    _, _, _, u11, u12, u13, u22, u23, u33, amplitude, _, part_x, part_y, part_z = numbers.unbind(1)
    first = [u11 * a + u12 * b + u13 * c for a, b, c in ((wxx, wxy, wxz), (wxy, wyy, wyz), (wxz, wyz, wzz))]
    second = [u22 * b + u23 * c for b, c in ((wyy, wyz), (wyz, wzz))]
    a, b, c = u11 * wx + u12 * wy + u13 * wz, u22 * wy + u23 * wz, u33 * wz
    to_x = [u11 * a - part_x * t, u12 * a + u22 * b - part_y * t, u13 * a + u23 * b + u33 * c - part_z * t]
    to_u = [*(-value for value in first), *(-value for value in second), -u33 * wzz]
    return torch.stack([*to_x, *to_u, w / amplitude, t, tx, ty, tz], 1)
