"""Volumes of divided Gaussians, each voxel holding its mean, differentiable."""

import numpy as np
from jaxtyping import Float, Float32
from torch import Tensor

from phantomgen.geometry.voxel_grid import Grid
from phantomgen.ops.simd import WIDTH
from recon.ops.cpu_function import apply_on_cpu, on_gpu
from recon.ops.interface import cpu_voxel_table, cpu_voxels
from recon.ops.interface.arrays import DividedTensors, ShapeGradients, Shapes, SideGradients, Sides, VoxelNumbers
from recon.ops.interface.voxel_table import NUMBERS, SUMS
from recon.ops.pieces import run_in_pieces
from recon.ops.rasterize.cpu import whitening, whitening_backward

CHUNK = 256  # Gaussians per piece of work
SLAB = 4  # slices per piece of work


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
    means, in the type of the coefficients, differentiable once in all arrays of the Gaussians [1/mm]

    Notes
    -----
    `recon.ops.interface.cpu_voxel_table.fill_table` has the approximation. Errors are below 0.01 of the difference
    between the sides in voxels that the plane crosses.
    """
    if on_gpu(gaussians.centres):
        from recon.ops.interface.gpu.calls import voxelize_on_gpu  # noqa: PLC0415 - Triton only where there is a GPU

        return voxelize_on_gpu(gaussians, grid, cutoff)
    return apply_on_cpu(lambda parts: _Call(parts, grid, cutoff), gaussians)


class _Call:
    """Arrays of one call: geometry in float64, numbers and voxels in float32."""

    def __init__(self, gaussians: DividedTensors, grid: Grid, cutoff: float) -> None:
        exact = [part.detach().numpy().astype(np.float64) for part in gaussians[:4]]
        centres, log_scales, self.quaternions, planes = exact
        below, above = gaussians.below.detach(), gaussians.above.detach()
        self.sides = Sides(*(part.float().contiguous().numpy() for part in (below, above - below)))
        self.bases, self.shape, self.cutoff = (0,) * below.shape[1], grid.shape, cutoff
        self.lattice = np.array(grid.origin[::-1]), np.array(grid.spacing[::-1])
        n = len(centres)
        self.shapes = Shapes(centres, log_scales, np.empty((n, 3, 3)), planes)
        table, voxels, halves = (
            np.empty((n, NUMBERS), np.float32),
            np.empty((n, 3), np.int64),
            np.empty((n, 2), np.float32),
        )
        self.numbers = VoxelNumbers(table, voxels, halves)
        run_in_pieces(self._measure, n, CHUNK)

    def _measure(self, first: int, last: int) -> None:
        """Compute the numbers of some Gaussians."""
        whitening(self.shapes.log_scales, self.quaternions, first, last, self.shapes.matrices)
        cpu_voxel_table.fill_table(self.shapes, self.lattice, self.cutoff, (first, last), self.numbers)

    def values(self) -> Float32[np.ndarray, "basis z y x"]:
        """Compute the means."""
        slices, rows, columns = self.shape
        volume = np.zeros((len(self.bases), slices, rows, columns + WIDTH), np.float32)

        def fill(first: int, last: int) -> None:
            cpu_voxels.fill(self.bases, self.numbers, self.sides, self.cutoff, columns, (first, last), volume)

        run_in_pieces(fill, slices, SLAB)
        return volume[..., :columns]

    def gradients(self, cotangent: Float[Tensor, "basis z y x"]) -> list[np.ndarray]:
        """Compute the gradients in the six arrays of the Gaussians from those in the means."""
        volume = cotangent.detach().numpy()
        n, columns = len(self.shapes.centres), volume.shape[3]
        padded = np.zeros((*volume.shape[:3], columns + WIDTH), np.float32)
        padded[..., :columns] = volume
        bases = (n, len(self.bases))
        to_sides = SideGradients(np.zeros((n, SUMS)), np.zeros(bases), np.zeros(bases))
        to_shapes = ShapeGradients(np.empty((n, 3)), np.empty((n, 3, 3)), np.empty((n, 2)))
        to_log_scales, to_quaternions = np.empty((n, 3)), np.empty((n, 4))

        def gather(first: int, last: int) -> None:
            part = first, last
            cpu_voxels.backward(self.bases, self.numbers, self.sides, padded, self.cutoff, columns, part, to_sides)
            cpu_voxel_table.backward(self.shapes, self.lattice, to_sides.sums, part, to_shapes)
            whitening_backward(
                self.shapes.log_scales, self.quaternions, self.shapes.matrices, to_shapes.matrices, first, last,
                to_log_scales, to_quaternions,
            )  # fmt: skip

        run_in_pieces(gather, n, CHUNK)
        both = [to_sides.below - to_sides.step, to_sides.step]
        return [to_shapes.centres, to_log_scales, to_quaternions, to_shapes.planes, *both]
