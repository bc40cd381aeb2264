"""One call of the rasterizer on the CPU: which views at a time, and how the threads share them."""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float32
from torch import Tensor

from phantomgen.ops.simd import WIDTH
from recon.ops.arguments import (
    GaussianArrays,
    GaussianGradients,
    GaussianTensors,
    RayFrame,
    TensorGradients,
    inverse_frames,
)
from recon.ops.pieces import run_all, run_in_pieces
from recon.ops.rasterize import cpu
from recon.ops.rasterize import near_field as near
from recon.ops.rasterize.footprint_table import FOOTPRINT_SIZE, ROW_0, ROW_1, Views
from recon.ops.rasterize.projector import Projector

CHUNK = 2048  # Gaussians per piece of work
BANDS = 4  # pieces of work that the rows of a view are shared between
TABLE_BYTES = 2**28  # bytes; footprints of a group of views, which has one view at least


class ViewGroup(NamedTuple):
    """Views that are computed together.

    Parameters
    ----------
    numbers : which views
    tables : numbers of their footprints
    lengths : lengths |d| of their rays [mm]
    """

    numbers: range
    tables: Float32[np.ndarray, "view gaussian 13"]
    lengths: Float32[np.ndarray, "view row column"]


class RasterizeCall:
    """Arrays of one call of the rasterizer: geometry in float64, pixels in float32.

    Footprints are kept for the gradients if those of all views fit into TABLE_BYTES, and computed again if not.

    Parameters
    ----------
    parts : Gaussians
    frames : per view source, d0, column step and row step [mm]
    panel : rows and columns
    projector : how Gaussians are projected
    """

    def __init__(self, parts: GaussianTensors, frames: Tensor, panel: tuple[int, int], projector: Projector) -> None:
        centres, self.log_scales, self.quaternions, self.frames = (
            x.detach().cpu().numpy().astype(np.float64) for x in (*parts[:3], frames)
        )
        coefficients = parts.coefficients.detach().cpu().numpy().astype(np.float32)
        self.gaussians = GaussianArrays(centres, np.empty((len(centres), 3, 3)), coefficients)
        self.bases = (0,) * coefficients.shape[1]
        self.panel, self.projector, self.sampling = panel, projector, projector.sampling
        self.inverses = inverse_frames(self.frames)
        self._each_chunk(lambda a, b: cpu.whitening(self.log_scales, self.quaternions, a, b, self.gaussians.matrices))
        self._kept: list[ViewGroup] = []

    def values(self) -> Float[np.ndarray, "view basis row column"]:
        """Compute line integrals.

        Returns
        -------
        line integrals, dimensionless
        """
        (rows, columns), bases = self.panel, self.gaussians.coefficients.shape[1]
        image = np.zeros((len(self.frames), bases, rows, columns + WIDTH), np.float32)
        for views in self.groups():
            self._add_bands(views, image)
        return image[..., :columns]

    def gradients(self, cotangent: Float[Tensor, "view basis row column"]) -> TensorGradients:
        """Compute gradients in the tensors of the Gaussians.

        Parameters
        ----------
        cotangent : gradient in the line integrals

        Returns
        -------
        gradients in each tensor
        """
        n, bases = self.gaussians.coefficients.shape
        (rows, columns), images = self.panel, cotangent.detach().cpu().numpy()
        sums = GaussianGradients(np.zeros((n, 3)), np.zeros((n, 3, 3)), np.zeros((n, bases)))
        for group in self.groups():
            some = slice(group.numbers.start, group.numbers.stop)
            padded = np.zeros((len(group.numbers), bases, rows, columns + WIDTH), np.float32)
            padded[..., :columns] = images[some]
            padded[..., :columns] *= group.lengths[:, None]
            views = Views(self.frames[some], self.inverses[some], group.tables)
            self._each_chunk(lambda a, b, v=views, p=padded: self._add_gradients(v, p, a, b, sums))
        to_scales, to_quaternions = np.empty((n, 3)), np.empty((n, 4))
        self._each_chunk(
            lambda a, b: cpu.whitening_backward(
                self.log_scales, self.quaternions, self.gaussians.matrices, sums.matrices, a, b,
                to_scales, to_quaternions,
            )
        )  # fmt: skip
        return TensorGradients(sums.centres, to_scales, to_quaternions, sums.coefficients)

    def groups(self) -> Iterator[ViewGroup]:
        """Yield all views in their order, as many at a time as TABLE_BYTES holds.

        Yields
        ------
        views with their footprints; arrays are used again for the next views
        """
        if self._kept:
            yield from self._kept
            return
        n, views = len(self.gaussians.centres), len(self.frames)
        size = max(1, TABLE_BYTES // max(4 * FOOTPRINT_SIZE * n, 1))
        tables = np.empty((min(size, views), n, FOOTPRINT_SIZE), np.float32)
        lengths = np.empty((min(size, views), *self.panel), np.float32)
        for first in range(0, views, size):
            numbers = range(first, min(first + size, views))
            group = ViewGroup(numbers, tables[: len(numbers)], lengths[: len(numbers)])
            self._measure(group)
            self._project(group)
            if len(numbers) == views:
                self._kept = [group]
            yield group

    def _each_chunk(self, task: Callable[[int, int], None]) -> None:
        run_in_pieces(task, len(self.gaussians.centres), CHUNK)

    def _view(self, number: int) -> RayFrame:
        return RayFrame(self.frames[number], self.inverses[number])

    def _project(self, views: ViewGroup) -> None:
        """Compute the footprints of some views."""
        n = len(self.gaussians.centres)

        def project(piece: tuple[int, int]) -> None:
            i, a = piece
            self._footprints(self._view(views.numbers[i]), a, min(a + CHUNK, n), views.tables[i])

        run_all(project, [(i, a) for i in range(len(views.numbers)) for a in range(0, n, CHUNK)])

    def _add_bands(self, views: ViewGroup, image: np.ndarray) -> None:
        """Add the footprints of some views to `image` (view, basis, row, padded column)."""
        rows = self.panel[0]

        def add(piece: tuple[int, int]) -> None:
            i, band = piece
            number, ends = views.numbers[i], (band * rows // BANDS, (band + 1) * rows // BANDS)
            self._add_rows(self._view(number), views.tables[i], views.lengths[i], ends, image[number])

        run_all(add, [(i, band) for i in range(len(views.numbers)) for band in range(BANDS)])

    def _footprints(self, view: RayFrame, first: int, last: int, table: np.ndarray) -> None:
        """Compute the footprints of some Gaussians in one view."""
        cpu.footprints(self.gaussians, view, self.sampling, self.panel[0], first, last, table)

    def _add_rows(
        self, view: RayFrame, table: np.ndarray, lengths: np.ndarray, rows: tuple[int, int], image: np.ndarray
    ) -> None:
        """Add the footprints of all Gaussians in one view to some rows of its image."""
        sampling, which = self.sampling, np.flatnonzero(table[:, ROW_1] < table[:, ROW_0])
        if len(which):
            near.forward(which, self.gaussians, view, table, sampling, *rows, image)
        cpu.forward(self.bases, table, self.gaussians.coefficients, lengths, sampling.cutoff, *rows, image)

    def _add_gradients(
        self, views: Views, padded: np.ndarray, first: int, last: int, gradients: GaussianGradients
    ) -> None:
        """Add the gradients of some Gaussians in some views."""
        cpu.backward(
            self.bases, self.gaussians, views, padded, self.sampling, first, last, gradients
        )  # fmt: skip

    def _measure(self, views: ViewGroup) -> None:
        """Fill the length |d| of each ray; 1 in the local-affine projection, whose footprints hold one length each."""
        x, y = np.arange(self.panel[1])[None, :, None], np.arange(self.panel[0])[:, None, None]
        for lengths, number in zip(views.lengths, views.numbers, strict=True):
            if self.projector.affine:
                lengths.fill(1)
            else:
                _, first, column_step, row_step = self.frames[number]
                lengths[:] = np.linalg.norm(first + x * column_step + y * row_step, axis=-1)
