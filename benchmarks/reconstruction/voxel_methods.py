"""Error against time of reconstructions on voxels: what a reconstruction by Gaussians has to beat.

    phantomgen make benchmarks/scenes/development.yaml -o tuning.h5
    phantomgen make --preset kedge -o kedge.h5
    python -m benchmarks.reconstruction.voxel_methods tuning.h5 kedge.h5

Decomposition of each ray by maximum likelihood, then FDK or PDHG-TV; one-step with and without its prior. Settings are
the defaults, which were chosen on `tuning`. Seconds are of processor time, of all threads together, without what
compiles; PSNR (`recon.evaluation.metrics.psnr`) is over the whole volume, its peak the largest true coefficient of the
basis.
"""

import platform
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from phantomgen.dataset.inpainting import inpainted
from phantomgen.dataset.reader import Dataset, open_dataset
from phantomgen.dataset.truth import Truth, read_truth
from phantomgen.geometry.voxel_grid import Grid
from recon.data.material_decomposition import decompose_views
from recon.data.measurements import Measurements, matching_bin, read_measurements
from recon.evaluation.metrics import psnr
from recon.voxel.filtered.fdk import fdk
from recon.voxel.iterative.one_step import OneStep
from recon.voxel.iterative.pdhg_tv import PdhgTv
from recon.voxel.method import Iteration
from spectra.threads import thread_count, without_other_pools

RESULTS = Path(__file__).parents[1] / "results" / "voxel_methods.txt"
DISPERSION = 0.02  # of the decomposition
NODE_TOLERANCE = 1e-3
ONE_STEP_AT, PDHG_AT = (4, 8, 16), (25, 50, 100)
Told = Callable[[str, float, np.ndarray], None]


class Clock:
    """Processor time less what is spent on scores."""

    def __init__(self) -> None:
        self.began, self.paused = time.process_time(), 0.0

    def seconds(self) -> float:
        return time.process_time() - self.began - self.paused

    def watch(self, at: tuple[int, ...], first: int, tell: Callable[[str, float, np.ndarray], None]) -> Callable:
        """A callback that scores some iterations."""

        def on_iteration(state: Iteration) -> None:
            seconds, begun = self.seconds(), time.process_time()
            if state.done - first in at:
                tell(f"{state.done - first} iterations", seconds, state.volumes)
            self.paused += time.process_time() - begun

        return on_iteration


def two_step(measured: Measurements, grid: Grid, tell: Told) -> None:
    clock = Clock()
    data = measured.completed().binned(matching_bin(measured.geometry, min(grid.spacing)))
    line_integrals, fisher = decompose_views(data, DISPERSION)
    line_integrals = inpainted(line_integrals, data.blind_pixels)
    volumes = fdk(line_integrals, data.geometry, grid)
    tell("ML, then FDK", clock.seconds(), volumes)
    images = np.ascontiguousarray(np.moveaxis(line_integrals, 1, 0))
    named = clock.watch(PDHG_AT, 0, lambda name, *rest: tell(f"ML, then PDHG-TV, {name}", *rest))
    PdhgTv().reconstruct(images, fisher, data.geometry, grid, named, start=np.maximum(volumes, 0))


def one_step(measured: Measurements, grid: Grid, strength: float, tell: Told) -> None:
    method = replace(OneStep(), strength=strength)
    name = "one-step" if strength else "one-step without prior"
    before = sum(passes for factor, passes in method.levels if factor > 1)
    clock = Clock()
    watch = clock.watch(ONE_STEP_AT, before, lambda when, *rest: tell(f"{name}, {when}", *rest))
    method.reconstruct_counts(measured, grid, watch)


def compile_all(measured: Measurements, grid: Grid) -> None:
    """Run everything once on a few voxels."""
    few = Grid((8, 8, 8), tuple(16 * s for s in grid.spacing), grid.origin)  # type: ignore[arg-type]
    OneStep(levels=((1, 1),)).reconstruct_counts(measured[:4], few)
    data = measured.completed()[:4].binned(matching_bin(measured.geometry, min(grid.spacing)))
    line_integrals, fisher = decompose_views(data, DISPERSION)
    PdhgTv(iterations=1).reconstruct(np.moveaxis(line_integrals, 1, 0), fisher, data.geometry, few)


def rows(dataset: Dataset, truth: Truth) -> Iterator[str]:
    """Lines of the table."""
    measured = read_measurements(dataset, dataset.splits["train"]).without_partial_volume()
    measured, _ = measured.compressed(NODE_TOLERANCE)
    compile_all(measured, dataset.grid)
    lines: list[str] = []

    def tell(name: str, seconds: float, volumes: np.ndarray) -> None:
        scores = [
            psnr(float(t.max()), float(np.mean((v - t) ** 2))) for v, t in zip(volumes, truth.volumes, strict=True)
        ]
        numbers = "".join(f"{s:9.2f}" for s in [*scores, np.mean(scores)])
        lines.append(f"{dataset.path.stem:12s}{name:36s}{seconds:9.1f}{numbers}")

    two_step(measured, dataset.grid, tell)
    for strength in (0.0, OneStep().strength):
        one_step(measured, dataset.grid, strength, tell)
        yield from lines
        lines.clear()


@without_other_pools()
def main() -> None:
    out = [f"{platform.machine()}, {thread_count()} threads; settings were chosen on tuning"]
    for path in sys.argv[1:]:
        truth = read_truth(path)
        with open_dataset(path) as dataset:
            names = "".join(f"{name[:8]:>9s}" for name in [*truth.basis_names, "mean"])
            out.append(f"{'scan':12s}{'method':36s}{'CPU [s]':>9s}{names}")
            out.extend(rows(dataset, truth))
        print("\n".join(out), flush=True)
    RESULTS.write_text("\n".join(out) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
