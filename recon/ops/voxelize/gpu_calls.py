"""One call of the voxelizer on a GPU: shapes of Gaussians by torch in float64, voxels by Triton in float32.

Memory besides the volume: some 1 kB per Gaussian, and 16 bytes for every tile of 4 x 8 x 8 voxels that it reaches.
"""

import itertools
import math
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from phantomgen.geometry.voxel_grid import Grid
from recon.ops.arguments import GaussianTensors
from recon.ops.rasterize.footprint_table import NARROWEST
from recon.ops.rasterize.footprints import whitening
from recon.ops.voxelize import gpu
from recon.ops.voxelize.cpu import FARTHEST, SLACK

_NEIGHBOURS = [k for k in itertools.product((-1.0, 0.0, 1.0), repeat=3) if k > (0.0, 0.0, 0.0)]


def voxelize_on_gpu(
    gaussians: GaussianTensors, grid: Grid, footprint: float, cutoff: float
) -> Float[Tensor, "basis z y x"]:
    """Compute the volume of `recon.ops.voxelize.voxelize_tensor` on the device of the Gaussians.

    Parameters
    ----------
    gaussians : Gaussians on a GPU
    grid, footprint, cutoff : as in `recon.ops.voxelize.voxelize`

    Returns
    -------
    volumes [1/mm]
    """
    return _VoxelizeOnGpu.apply(*gaussians, grid, footprint, cutoff)  # type: ignore[return-value]


class _VoxelizeOnGpu(torch.autograd.Function):
    @staticmethod
    def forward(ctx, centres, log_scales, quaternions, coefficients, grid, footprint, cutoff):
        ctx.save_for_backward(centres, log_scales, quaternions, coefficients)
        ctx.settings = grid, footprint, cutoff
        found = _shapes(centres.double(), log_scales.double(), quaternions.double(), grid, footprint)
        weights = coefficients.float().contiguous()
        return gpu.forward(found.rounded(grid.shape, cutoff), weights, grid.shape, cutoff).to(coefficients.dtype)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, *cotangents):
        *geometry, coefficients = ctx.saved_tensors
        grid, footprint, cutoff = ctx.settings
        leaves = [part.detach().double().requires_grad_() for part in geometry]
        with torch.enable_grad():
            found = _shapes(leaves[0], leaves[1], leaves[2], grid, footprint)
        weights, cotangent = coefficients.float().contiguous(), cotangents[0].float().contiguous()
        sums, to_coefficients = gpu.backward(found.rounded(grid.shape, cutoff), weights, cotangent, cutoff)
        numbers = found.offsets, found.covariances, found.log_amplitudes
        gradients = torch.autograd.grad(numbers, leaves, found.gradients(sums.double()))
        pairs = zip((*gradients, to_coefficients), ctx.saved_tensors, strict=True)
        return *(gradient.to(part.dtype) for gradient, part in pairs), None, None, None


class _Shapes(NamedTuple):
    """Gaussians averaged over voxels, in voxels (x, y, z): exp(log amplitude - d^T C^-1 d / 2)."""

    offsets: Float[Tensor, "gaussian 3"]  # of the centre from `voxels`
    covariances: Float[Tensor, "gaussian 3 3"]
    log_amplitudes: Float[Tensor, " gaussian"]
    voxels: Float[Tensor, "gaussian 3"]

    def rounded(self, shape: tuple[int, int, int], cutoff: float) -> gpu.Ellipsoids:
        """Round to the types of the kernels: C^-1 = U^T U with U upper triangular, and the voxels within the cutoff."""
        offsets, c, log_amplitudes, voxels = (part.detach() for part in self)
        l33 = torch.sqrt(c[:, 2, 2])
        l23, l13 = c[:, 1, 2] / l33, c[:, 0, 2] / l33
        l22 = torch.sqrt(c[:, 1, 1] - l23 * l23)
        l12 = (c[:, 0, 1] - l13 * l23) / l22
        l11 = torch.sqrt(c[:, 0, 0] - l12 * l12 - l13 * l13)
        u12, u23, u13 = -l12 / (l11 * l22), -l23 / (l22 * l33), (l12 * l23 - l13 * l22) / (l11 * l22 * l33)
        rows = torch.stack([1 / l11, u12, u13, 1 / l22, u23, 1 / l33, torch.exp(log_amplitudes)], 1)
        size = torch.tensor(shape[::-1], device=c.device)
        half = cutoff * torch.sqrt(torch.diagonal(c, dim1=1, dim2=2)) + SLACK
        first = torch.ceil(voxels + offsets - half).clamp(min=0).minimum(size)
        last = (torch.floor(voxels + offsets + half) + 1).minimum(size).maximum(first)
        ends = torch.stack([first, last], -1).flip(1).flatten(1)
        places = torch.cat([voxels, ends], 1).int().contiguous()
        return gpu.Ellipsoids(torch.cat([offsets, rows], 1).float().contiguous(), places)

    def gradients(self, sums: Float[Tensor, "gaussian 10"]) -> tuple[Tensor, Tensor, Tensor]:
        """Compute the gradients in offset, covariance and log amplitude from sums over voxels."""
        inverse = torch.linalg.inv(self.covariances.detach())
        squares = sums[:, [4, 5, 6, 5, 7, 8, 6, 8, 9]].reshape(-1, 3, 3)
        to_offsets = (inverse @ sums[:, 1:4, None])[:, :, 0]
        return to_offsets, inverse @ squares @ inverse / 2, sums[:, 0]


def _shapes(
    centres: Float[Tensor, "gaussian 3"],
    log_scales: Float[Tensor, "gaussian 3"],
    quaternions: Float[Tensor, "gaussian 4"],
    grid: Grid,
    footprint: float,
) -> _Shapes:
    """Compute shapes in float64, differentiable: the steps of `recon.ops.voxelize.cpu.shapes`."""
    origin, spacing = (centres.new_tensor(values[::-1]) for values in (grid.origin, grid.spacing))
    box, place = footprint**2 / 12, (centres - origin) / spacing
    voxels = torch.floor(place.detach() + 0.5).clamp(-FARTHEST, FARTHEST)
    offsets = place - voxels
    root = whitening(log_scales, quaternions).mT * torch.exp(2 * log_scales)[:, None] / spacing[:, None]
    covariances = root @ root.mT + box * torch.eye(3, dtype=root.dtype, device=root.device)
    narrow = log_scales.sum(1) - spacing.log().sum()
    log_amplitudes = narrow - torch.logdet(covariances) / 2
    if box >= NARROWEST:
        log_amplitudes = log_amplitudes - torch.log(lattice_mass(offsets, covariances))
    return _Shapes(offsets, covariances, log_amplitudes, voxels)


def lattice_mass(
    offsets: Float[Tensor, "gaussian 3"], covariances: Float[Tensor, "gaussian 3 3"]
) -> Float[Tensor, " gaussian"]:
    """Sum densities of unit mass over all voxels; see `recon.ops.voxelize.cpu.lattice_mass`.

    Parameters
    ----------
    offsets : of the centres from the middle of a voxel [voxels]
    covariances : averaged over a voxel [voxel^2]

    Returns
    -------
    sums, next to 1
    """
    k = offsets.new_tensor(_NEIGHBOURS)
    exponents = covariances.flatten(1) @ (k[:, :, None] * k[:, None]).flatten(1).T
    waves = torch.exp(-2 * math.pi**2 * exponents) * torch.cos(2 * math.pi * offsets @ k.T)
    return 1 + 2 * waves.sum(1)
