"""Accuracy and time of a fit against the number of Gaussians, plain and divided by planes.

    python -m benchmarks.reconstruction.gaussian_count [--counts N ...] [--kernels NAME ...] [--seeds N ...] [SCENE ...]
    python -m benchmarks.reconstruction.gaussian_count --figure

Scenes are `kedge-small` and those of `scene_kinds.yaml`: 64^3 voxels, 45 views of 128 x 128 pixels. `recon fit
--gaussians N` places N Gaussians; 0 stands for as many as the recipe places. A row states the Gaussians, the numbers
that they store, processor seconds of the whole fit, the PSNR [dB] of every basis volume on the grid of the truth, and
on a grid twice as fine, whose truth is computed from the shapes. The row named `voxels` is the one-step volume that
every fit starts from; on the finer grid, each of its voxels stands for eight.

Rows take the place of those in `results/gaussian_count.txt`; `--figure` draws the table, `results/gaussian_count.png`.
"""

import argparse
import platform
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml
from jaxtyping import Float

import phantomgen
from benchmarks.reconstruction.scene_kinds import SCENES, recipe_with, scanned, scores
from benchmarks.result_rows import store
from phantomgen.dataset.truth import Truth, read_truth
from phantomgen.scene.scan import Scan
from phantomgen.simulation.forward_model.truth import scan_truth
from recon.gaussians.recipe import KERNELS, with_count
from recon.gaussians.reconstruct import reconstruct
from spectra.threads import set_threads, thread_count, without_other_pools

TABLE = Path(__file__).parents[1] / "results" / "gaussian_count.txt"
DEFAULT_SCENES = ("kedge-small", "vessels", "boxes", "smooth", "foam", "two-agents")
COUNTS = (100, 300, 1000, 3000, 10_000, 30_000)
NAMED = 36  # characters of a row for its scene, kernel, wanted number and seed
HEADER = (
    f"{'scene':<12}{'kernel':<11}{'wanted':>7}{'seed':>5} {'Gaussians':>10}{'numbers':>9}{'CPU s':>7}   PSNR / finer"
)


@dataclass(frozen=True)
class Truths:
    """The truth on two grids.

    Parameters
    ----------
    same : on the grid of the scan
    finer : on a grid of voxels half as wide
    """

    same: Truth
    finer: Truth

    @classmethod
    def of(cls, scan_path: Path, finer: Scan) -> "Truths":
        """Read the one and compute the other."""
        same = read_truth(scan_path)
        assert same is not None
        return cls(same, scan_truth(finer))


def finer_scene(changes: dict) -> Scan:
    """Make the scene anew with voxels half as wide."""
    lines = [f"{key}={yaml.safe_dump(value, default_flow_style=True, width=10**6)}" for key, value in changes.items()]
    scan = phantomgen.load("kedge-small", lines)
    return phantomgen.load("kedge-small", [*lines, f"volume.voxels={2 * scan.grid.shape[0]}"])


def row_of(
    label: str,
    count: int,
    numbers: int,
    seconds: float,
    volumes: Sequence[Float[np.ndarray, "basis z y x"]],
    truth: Truths,
) -> str:
    """One line of the results, for volumes on both grids."""
    same, finer = scores(volumes[0], truth.same), scores(volumes[1], truth.finer)
    told = " ".join(f"{value:5.2f}" for value in same) + " / " + " ".join(f"{value:5.2f}" for value in finer)
    return f"{label:<{NAMED}}{count:>10}{numbers:>9}{seconds:>7.0f}   {told}"


def label_of(scene: str, kernel: str, wanted: int, seed: int) -> str:
    """Name of a row."""
    return f"{scene:<12}{kernel:<11}{wanted:>7}{seed:>5} "


def main() -> None:
    changes = {"kedge-small": {}} | yaml.safe_load(SCENES.read_text(encoding="utf-8"))
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("scenes", nargs="*", default=DEFAULT_SCENES, metavar="SCENE", help=", ".join(changes))
    parser.add_argument("--counts", type=int, nargs="+", default=COUNTS, help="wanted numbers; 0: as the recipe places")
    parser.add_argument("--kernels", choices=KERNELS, nargs="+", default=KERNELS)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0], help="of the noise")
    parser.add_argument("--threads", type=int, help="default: all")
    parser.add_argument("--table", type=Path, default=TABLE, help="file that the rows go to")
    parser.add_argument("--figure", action="store_true", help="draw the table and measure nothing")
    asked = parser.parse_args()
    if unknown := set(asked.scenes) - set(changes):
        parser.error(f"no scene {', '.join(sorted(unknown))}; there are {', '.join(changes)}")
    if asked.figure:
        from benchmarks.reconstruction.gaussian_count_figure import draw  # noqa: PLC0415 - matplotlib

        draw(asked.table)
        return
    set_threads(asked.threads)
    print(HEADER)
    for scene in asked.scenes:
        for seed in asked.seeds:
            measure(scene, changes[scene], seed, asked)


@without_other_pools()
def measure(scene: str, changes: dict, seed: int, asked: argparse.Namespace) -> None:
    """Fit one scan with all kernels and numbers."""
    head = [f"{platform.machine()}, {thread_count()} threads", HEADER]
    with tempfile.TemporaryDirectory() as folder, scanned(scene, changes, seed, Path(folder) / "scan.h5") as dataset:
        truth = Truths.of(dataset.path, finer_scene(changes))
        rows = 0
        for kernel in asked.kernels:
            for wanted in asked.counts:
                began = time.process_time()
                found = reconstruct(dataset, with_count(recipe_with(kernel, 0.0), wanted))
                seconds = time.process_time() - began
                model, voxels = found.gaussians, found.initial_volumes
                volumes = [model.volume(part.grid) for part in (truth.same, truth.finer)]
                lines = [
                    row_of(label_of(scene, kernel, wanted, seed), len(model), model.numbers, seconds, volumes, truth)
                ]
                if not rows:
                    repeated = voxels.repeat(2, 1).repeat(2, 2).repeat(2, 3)
                    label, first = label_of(scene, "voxels", 0, seed), found.seconds[found.start]
                    lines.insert(0, row_of(label, voxels[0].size, voxels.size, first, [voxels, repeated], truth))
                for line in lines:
                    store(asked.table, head, line, NAMED)
                    print(line, flush=True)
                rows += 1


if __name__ == "__main__":
    main()
