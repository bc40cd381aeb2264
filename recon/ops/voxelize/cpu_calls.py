"""Arrays of one call of the voxelizer on the CPU: geometry in float64, voxels in float32."""

import numpy as np
from jaxtyping import Float
from torch import Tensor

from phantomgen.geometry.voxel_grid import Grid
from phantomgen.ops.simd import WIDTH
from recon.ops.arguments import GaussianArrays, GaussianTensors, TensorGradients, lattice_of
from recon.ops.pieces import run_in_pieces
from recon.ops.rasterize.cpu import whitening, whitening_backward
from recon.ops.voxelize import cpu
from recon.ops.voxelize.backward import VoxelizeGradients, backward

SLAB = 4  # slices per piece of work
CHUNK = 2048  # Gaussians per piece of work


class VoxelizeCall:
    """Arrays of one call of the voxelizer.

    Parameters
    ----------
    parts : Gaussians
    grid, footprint, cutoff : as in `recon.ops.voxelize.voxelize`
    """

    def __init__(self, parts: GaussianTensors, grid: Grid, footprint: float, cutoff: float) -> None:
        centres, self.log_scales, self.quaternions = (x.detach().cpu().numpy().astype(np.float64) for x in parts[:3])
        coefficients, n = parts.coefficients.detach().cpu().numpy().astype(np.float32), len(centres)
        self.gaussians = GaussianArrays(centres, np.empty((n, 3, 3)), coefficients)
        self.bases, self.shape = (0,) * coefficients.shape[1], grid.shape
        self.sampling = cpu.VoxelSampling(*lattice_of(grid), footprint**2 / 12, float(cutoff))
        self.table = np.empty((n, cpu.SHAPE_SIZE), np.float32)
        run_in_pieces(self._shapes, n, CHUNK)

    def _shapes(self, first: int, last: int) -> None:
        whitening(self.log_scales, self.quaternions, first, last, self.gaussians.matrices)
        cpu.shapes(self.gaussians, self.sampling, first, last, self.table)

    def values(self) -> Float[np.ndarray, "basis z y x"]:
        """Compute the voxel means of every basis.

        Returns
        -------
        volumes [1/mm]
        """
        slices, rows, columns = self.shape
        volume = np.zeros((len(self.bases), slices, rows, columns + WIDTH), np.float32)
        weights, cutoff = self.gaussians.coefficients, self.sampling.cutoff
        run_in_pieces(lambda a, b: cpu.fill(self.bases, self.table, weights, cutoff, a, b, volume), slices, SLAB)
        return np.ascontiguousarray(volume[..., :columns])

    def gradients(self, cotangent: Float[Tensor, "basis z y x"]) -> TensorGradients:
        """Compute gradients in the tensors of the Gaussians.

        Parameters
        ----------
        cotangent : gradient in the volumes

        Returns
        -------
        gradients in each tensor
        """
        n, bases = self.gaussians.coefficients.shape
        columns = self.shape[2]
        padded = np.zeros((*cotangent.shape[:3], columns + WIDTH), np.float32)
        padded[..., :columns] = cotangent.detach().cpu().numpy()
        found = VoxelizeGradients(np.empty((n, 3)), np.empty((n, 3, 3)), np.empty((n, bases)), np.empty(n))
        to_scales, to_quaternions = np.empty((n, 3)), np.empty((n, 4))

        def gather(first: int, last: int) -> None:
            backward(self.bases, self.gaussians, self.table, padded, self.sampling, first, last, found)
            whitening_backward(
                self.log_scales, self.quaternions, self.gaussians.matrices, found.matrices, first, last,
                to_scales, to_quaternions,
            )  # fmt: skip

        run_in_pieces(gather, n, CHUNK)
        to_scales += found.log_peaks[:, None]  # the mean over voxels is proportional to the product of the scales
        return TensorGradients(found.centres, to_scales, to_quaternions, found.coefficients)
