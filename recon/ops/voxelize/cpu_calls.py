"""Arrays of one call of the voxelizer, as its kernels want them: geometry in float64, voxels in float32."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float
from torch import Tensor

from phantomgen.geometry.voxel_grid import Grid
from phantomgen.ops.simd import WIDTH
from recon.ops.rasterize.cpu import whitening, whitening_backward
from recon.ops.voxelize import cpu
from recon.ops.voxelize.backward import backward
from spectra.threads import run_parallel

SLAB = 4  # slices per piece of work
CHUNK = 2048  # Gaussians per piece of work


class Scene:
    """Gaussians on a grid; arguments as in `recon.ops.voxelize.voxelize`."""

    def __init__(
        self,
        centres: Tensor,
        log_scales: Tensor,
        quaternions: Tensor,
        coefficients: Tensor,
        grid: Grid,
        footprint: float,
        cutoff: float,
    ) -> None:
        self.centres, self.log_scales, self.quaternions = (
            x.detach().cpu().numpy().astype(np.float64) for x in (centres, log_scales, quaternions)
        )
        self.coefficients = coefficients.detach().cpu().numpy().astype(np.float32)
        self.bases = (0,) * self.coefficients.shape[1]
        self.shape, self.box, self.cutoff = grid.shape, footprint**2 / 12, cutoff
        self.origin, self.spacing = np.array(grid.origin[::-1], float), np.array(grid.spacing[::-1], float)
        n = len(self.centres)
        self.matrices, self.table = np.empty((n, 3, 3)), np.empty((n, cpu.SHAPE_SIZE), np.float32)
        self._each_chunk(self._shapes)

    def _each_chunk(self, task: Callable[[int, int], None]) -> None:
        n = len(self.centres)
        for _ in run_parallel(lambda a: task(a, min(a + CHUNK, n)), range(0, n, CHUNK)):
            pass

    def _shapes(self, a: int, b: int) -> None:
        whitening(self.log_scales, self.quaternions, a, b, self.matrices)
        cpu.shapes(
            self.centres, self.matrices, self.origin, self.spacing, self.box, self.cutoff, a, b, self.table
        )  # fmt: skip

    def volume(self) -> Float[np.ndarray, "basis z y x"]:
        """Voxel means of every basis."""
        slices, rows, columns = self.shape
        volume = np.zeros((self.coefficients.shape[1], slices, rows, columns + WIDTH), np.float32)

        def fill(first: int) -> None:
            last = min(first + SLAB, slices)
            cpu.fill(self.bases, self.table, self.coefficients, self.cutoff, columns, first, last, volume)

        for _ in run_parallel(fill, range(0, slices, SLAB)):
            pass
        return np.ascontiguousarray(volume[..., :columns])

    def gradients(self, cotangent: Float[Tensor, "basis z y x"]) -> tuple[np.ndarray, ...]:
        """Gradients in centres, log-scales, quaternions and coefficients."""
        n, bases = self.coefficients.shape
        columns = self.shape[2]
        padded = np.zeros((*cotangent.shape[:3], columns + WIDTH), np.float32)
        padded[..., :columns] = cotangent.detach().cpu().numpy()
        to_centres, to_matrices, to_coefficients = np.empty((n, 3)), np.empty((n, 3, 3)), np.empty((n, bases))
        to_scales, to_quaternions, to_log_peaks = np.empty((n, 3)), np.empty((n, 4)), np.empty(n)

        def gather(a: int, b: int) -> None:
            backward(
                self.bases, self.centres, self.matrices, self.coefficients, self.table, padded, self.origin,
                self.spacing, self.box, self.cutoff, columns, a, b,
                to_centres, to_matrices, to_log_peaks, to_coefficients,
            )  # fmt: skip
            whitening_backward(
                self.log_scales, self.quaternions, self.matrices, to_matrices, a, b, to_scales, to_quaternions
            )

        self._each_chunk(gather)
        to_scales += to_log_peaks[:, None]  # a mean over voxels goes with the product of the standard deviations
        return to_centres, to_scales, to_quaternions, to_coefficients
