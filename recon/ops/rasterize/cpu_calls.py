"""One call of the rasterizer on the CPU: which views at a time, and how they are shared between threads."""

from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple, TypeVar

import numpy as np
from jaxtyping import Float
from torch import Tensor

from phantomgen.ops.simd import WIDTH
from recon.ops.rasterize import cpu
from recon.ops.rasterize import near_field as near
from recon.ops.rasterize.footprint_table import FOOTPRINT_SIZE, ROW_0, ROW_1
from spectra.threads import run_parallel

CHUNK = 2048  # Gaussians per piece of work
BANDS = 4  # pieces of work that the rows of a view are shared between
TABLE_BYTES = 2**28  # footprints of a group of views, which has one view at least

T = TypeVar("T")


class Settings(NamedTuple):
    """What a call is about besides tensors: size of the panel, and how footprints are made."""

    rows: int
    columns: int
    footprint: float
    cutoff: float
    affine: bool


class Views(NamedTuple):
    """Some views: which, their footprints, and the lengths of their rays (view, row, column)."""

    numbers: range
    tables: np.ndarray
    lengths: np.ndarray


class Scene:
    """Arrays of one call, as the kernels want them: geometry in float64, pixels in float32.

    Footprints are kept for the gradients if those of all views fit into TABLE_BYTES, and made again if not.
    """

    def __init__(self, parts: tuple[Tensor, ...], frames: Tensor, settings: Settings) -> None:
        self.centres, self.log_scales, self.quaternions, self.frames = (
            x.detach().cpu().numpy().astype(np.float64) for x in (*parts[:3], frames)
        )
        self.coefficients = parts[3].detach().cpu().numpy().astype(np.float32)
        self.bases = (0,) * self.coefficients.shape[1]
        self.settings, self.box = settings, settings.footprint**2 / 12
        self.inverses = np.linalg.inv(np.stack([self.frames[:, 2], self.frames[:, 3], self.frames[:, 1]], axis=-1))
        self.matrices = np.empty((len(self.centres), 3, 3))
        self._each_chunk(lambda a, b: cpu.whitening(self.log_scales, self.quaternions, a, b, self.matrices))
        self._kept: list[Views] = []

    def images(self) -> Float[np.ndarray, "view basis row column"]:
        """Line integrals."""
        rows, columns = self.settings.rows, self.settings.columns
        bases = self.coefficients.shape[1]
        image = np.zeros((len(self.frames), bases, rows, columns + WIDTH), np.float32)
        for views in self._groups():
            self._splat(views, image)
        return image[..., :columns]

    def gradients(self, cotangents: Tensor) -> tuple[np.ndarray, ...]:
        """Gradients with respect to centres, log-scales, quaternions and coefficients."""
        n, bases = self.coefficients.shape
        s, images = self.settings, cotangents.detach().cpu().numpy()
        to_centres, to_matrices, to_coefficients = np.zeros((n, 3)), np.zeros((n, 3, 3)), np.zeros((n, bases))
        for numbers, tables, lengths in self._groups():
            padded = np.zeros((len(numbers), bases, s.rows, s.columns + WIDTH), np.float32)
            padded[..., : s.columns] = images[numbers.start : numbers.stop]
            padded[..., : s.columns] *= lengths[:, None]
            self._gather(numbers, tables, padded, (to_centres, to_matrices, to_coefficients))
        to_scales, to_quaternions = np.empty((n, 3)), np.empty((n, 4))
        self._each_chunk(
            lambda a, b: cpu.whitening_backward(
                self.log_scales, self.quaternions, self.matrices, to_matrices, a, b, to_scales, to_quaternions
            )
        )
        return to_centres, to_scales, to_quaternions, to_coefficients

    def _gather(self, numbers: range, tables: np.ndarray, padded: np.ndarray, sums: tuple[np.ndarray, ...]) -> None:
        """Add the gradients of some views in centres, whitening matrices and coefficients."""
        s, some = self.settings, slice(numbers.start, numbers.stop)
        self._each_chunk(
            lambda a, b: cpu.backward(
                self.bases, self.centres, self.matrices, self.coefficients, self.frames[some], self.inverses[some],
                tables, padded, self.box, s.cutoff, s.affine, s.columns, a, b, *sums,
            )
        )  # fmt: skip

    def _each_chunk(self, task: Callable[[int, int], None]) -> None:
        n = len(self.centres)
        run_all(lambda a: task(a, min(a + CHUNK, n)), range(0, n, CHUNK))

    def _groups(self) -> Iterator[Views]:
        """All views in their order, as many at a time as TABLE_BYTES holds."""
        if self._kept:
            yield from self._kept
            return
        n, views = len(self.centres), len(self.frames)
        size = max(1, TABLE_BYTES // max(4 * FOOTPRINT_SIZE * n, 1))
        tables = np.empty((min(size, views), n, FOOTPRINT_SIZE), np.float32)
        lengths = np.empty((min(size, views), self.settings.rows, self.settings.columns), np.float32)
        for first in range(0, views, size):
            numbers = range(first, min(first + size, views))
            group = Views(numbers, tables[: len(numbers)], lengths[: len(numbers)])
            self._measure(group)
            self._project(group)
            if len(numbers) == views:
                self._kept = [group]
            yield group

    def _project(self, views: Views) -> None:
        """Fill the footprints of some views."""
        s, n = self.settings, len(self.centres)

        def project(piece: tuple[int, int]) -> None:
            i, a = piece
            frame, inverse = self.frames[views.numbers[i]], self.inverses[views.numbers[i]]
            cpu.footprints(
                self.centres, self.matrices, frame, inverse, self.box, s.cutoff, s.affine, s.rows,
                a, min(a + CHUNK, n), views.tables[i],
            )  # fmt: skip

        run_all(project, [(i, a) for i in range(len(views.numbers)) for a in range(0, n, CHUNK)])

    def _splat(self, views: Views, image: np.ndarray) -> None:
        """Add the footprints of some views to `image` (view, basis, row, padded column)."""
        s = self.settings

        def splat(piece: tuple[int, int]) -> None:
            i, band = piece
            number, table = views.numbers[i], views.tables[i]
            a, b = (band * s.rows // BANDS, (band + 1) * s.rows // BANDS)
            which = np.flatnonzero(table[:, ROW_1] < table[:, ROW_0])
            if len(which):
                near.forward(
                    which, self.centres, self.matrices, self.coefficients, self.frames[number], self.inverses[number],
                    table, self.box, s.cutoff, s.columns, a, b, image[number],
                )  # fmt: skip
            cpu.forward(
                self.bases, table, self.coefficients, views.lengths[i], s.cutoff, s.columns, a, b, image[number]
            )

        run_all(splat, [(i, band) for i in range(len(views.numbers)) for band in range(BANDS)])

    def _measure(self, views: Views) -> None:
        """Fill the length |d| of each ray; 1 in the local-affine projection, whose footprints hold one length each."""
        x, y = np.arange(self.settings.columns)[None, :, None], np.arange(self.settings.rows)[:, None, None]
        for lengths, number in zip(views.lengths, views.numbers, strict=True):
            if self.settings.affine:
                lengths.fill(1)
            else:
                _, first, column_step, row_step = self.frames[number]
                lengths[:] = np.linalg.norm(first + x * column_step + y * row_step, axis=-1)


def run_all(task: Callable[[T], None], pieces: Iterable[T]) -> None:
    """Do a task for all pieces, on all threads."""
    for _ in run_parallel(task, pieces):
        pass
