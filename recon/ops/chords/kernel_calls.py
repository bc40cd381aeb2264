"""Calls of the kernels: views, bands and slices shared between threads, as in the rasterizer."""

import numpy as np
from jaxtyping import Float
from torch import Tensor

from phantomgen.geometry.voxel_grid import Grid
from recon.ops.chords import cpu
from recon.ops.rasterize.cpu import whitening
from recon.ops.rasterize.cpu_calls import BANDS, CHUNK, Scene, Settings, Views, run_all
from spectra.threads import run_parallel

PARTS = 2  # points per edge of a voxel that tell how full it is
SLICES = 8  # per piece of work


class ChordScene(Scene):
    """Arrays of one call of `recon.ops.chords.chords`."""

    def __init__(self, parts: tuple[Tensor, ...], frames: Tensor, settings: Settings, smooth: float) -> None:
        super().__init__(parts, frames, settings)
        self.smooth = smooth

    def _project(self, views: Views) -> None:
        n = len(self.centres)

        def project(piece: tuple[int, int]) -> None:
            i, a = piece
            frame, inverse = self.frames[views.numbers[i]], self.inverses[views.numbers[i]]
            last, rows = min(a + CHUNK, n), self.settings.rows
            cpu.footprints(self.centres, self.matrices, frame, inverse, rows, a, last, views.tables[i])

        run_all(project, [(i, a) for i in range(len(views.numbers)) for a in range(0, n, CHUNK)])

    def _splat(self, views: Views, image: np.ndarray) -> None:
        s = self.settings

        def splat(piece: tuple[int, int]) -> None:
            i, band = piece
            a, b = (band * s.rows // BANDS, (band + 1) * s.rows // BANDS)
            target = image[views.numbers[i]]
            cpu.forward(views.tables[i], self.coefficients, views.lengths[i], self.smooth, s.columns, a, b, target)

        run_all(splat, [(i, band) for i in range(len(views.numbers)) for band in range(BANDS)])

    def _gather(self, numbers: range, tables: np.ndarray, padded: np.ndarray, sums: tuple[np.ndarray, ...]) -> None:
        some = slice(numbers.start, numbers.stop)
        self._each_chunk(
            lambda a, b: cpu.backward(
                self.centres, self.matrices, self.coefficients, self.frames[some], self.inverses[some], tables, padded,
                self.smooth, self.settings.columns, a, b, *sums,
            )
        )  # fmt: skip


def fill(
    centres: Float[Tensor, "ellipsoid 3"],
    log_axes: Float[Tensor, "ellipsoid 3"],
    quaternions: Float[Tensor, "ellipsoid 4"],
    values: Float[Tensor, " ellipsoid"],
    grid: Grid,
    parts: int = PARTS,
) -> Float[np.ndarray, "z y x"]:
    """Volume of ellipsoids of constant attenuation [1/mm], float32; values add up where they overlap.

    Parameters
    ----------
    centres, log_axes, quaternions : as of `recon.ops.chords.chords`
    values : attenuation inside [1/mm]
    grid : where to evaluate
    parts : points per edge of a voxel that tell how full it is
    """
    middles, axes, turns, inside = (
        x.detach().numpy().astype(np.float64) for x in (centres, log_axes, quaternions, values)
    )
    matrices = np.empty((len(middles), 3, 3))
    whitening(axes, turns, 0, len(middles), matrices)
    origin, spacing = np.array(grid.origin[::-1]), np.array(grid.spacing[::-1])
    out = np.zeros(grid.shape)

    def slab(first: int) -> None:
        last = min(first + SLICES, grid.shape[0])
        cpu.fill(middles, matrices, inside, origin, spacing, parts, first, last, out)

    for _ in run_parallel(slab, range(0, grid.shape[0], SLICES)):
        pass
    return out.astype(np.float32)
