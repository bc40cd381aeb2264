"""Whether a fit of Gaussians ends better than the volumes it started from, on one scene of every kind.

    python -m benchmarks.reconstruction.scene_kinds [--kernel NAME] [--residual] [--threads N] [--seed N] [SCENE ...]

Scenes of `scene_kinds.yaml`: 64^3 voxels, 45 views of 128 x 128 pixels unless the scene says otherwise; no setting of
the program was chosen on them. PSNR [dB] of every basis volume on the grid of the truth: the one-step volumes that the
fit starts from, the Gaussians fitted to these volumes, and the end of the fit. Then what the fit gains over its start;
chi-square of the test views in the worst channel, away from edges and of all rays; the number of Gaussians; stored
numbers over occupied voxels times bases; processor time of the fit.

With `--kernel gaussian`, no planes divide the Gaussians. With `--residual`, voxels keep what they leave unexplained.
With `--halfway`, plain Gaussians are fitted to the start on a second grid, too, half a voxel further along every axis,
with that weight and a cutoff of 3.5.

Rows take the place of those in `results/scene_kinds.txt`, or of the file after `--table`; `results/residual.txt` has
the rows with and without a residual.
"""

import argparse
import platform
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from jaxtyping import Float

import phantomgen
from benchmarks.result_rows import store
from phantomgen.dataset.reader import Dataset
from phantomgen.dataset.truth import Truth, read_truth
from recon.data.volume_edges import occupied_voxels
from recon.evaluation.metrics import psnr
from recon.evaluation.scoring import score_test_views
from recon.gaussians.model import GaussianModel
from recon.gaussians.optimize import Progress
from recon.gaussians.recipe import FAST, KERNELS, PLAIN_FAST, Recipe, with_residual_in_voxels
from recon.gaussians.reconstruct import reconstruct
from spectra.threads import set_threads, thread_count, without_other_pools

SCENES = Path(__file__).parents[1] / "scenes" / "scene_kinds.yaml"
TABLE = Path(__file__).parents[1] / "results" / "scene_kinds.txt"
NAMED = 32  # characters of a row for its scene, seed and second grid
HEADER = (
    f"{'scene':<{NAMED}}{'start':<24}{'fitted to start':<24}{'end':<24}{'gain':<24}"
    f"{'off edges':>9}{'all':>7}{'Gaussians':>11}{'numbers':>9}{'CPU s':>7}"
)


def scanned(name: str, changes: dict[str, Any], seed: int, path: Path) -> Dataset:
    """Scan of a scene."""
    lines = [f"{key}={yaml.safe_dump(value, default_flow_style=True, width=10**6)}" for key, value in changes.items()]
    scene = phantomgen.load("kedge-small", ["geometry.test_views=10", *lines, f"seed={seed}"])
    return phantomgen.make(scene, out=path, overwrite=True)


def scores(volumes: Float[np.ndarray, "basis z y x"], truth: Truth) -> Float[np.ndarray, " basis"]:
    """PSNR of each basis volume [dB]."""
    pairs = zip(volumes.astype(float), truth.volumes.astype(float), strict=True)
    return np.array([psnr(t.max(), np.mean((v - t) ** 2)) for v, t in pairs], float)


def recipe_with(kernel: str, halfway: float, residual: bool = False) -> Recipe:
    """Default recipe with a kernel, with a residual in voxels, and with a second grid where its weight is not 0."""
    if kernel == "interface":
        return with_residual_in_voxels(FAST) if residual else FAST
    fit = PLAIN_FAST.volume_fit
    return replace(PLAIN_FAST, volume_fit=replace(fit, halfway=halfway, cutoff=3.5) if halfway else fit)


def row_of(label: str, dataset: Dataset, recipe: Recipe) -> str:
    """One line of the results."""
    truth = read_truth(dataset.path)
    assert truth is not None
    first: list[GaussianModel] = []

    def on_step(progress: Progress) -> None:
        if progress.step == 1:
            first.append(progress.gaussians.detached())

    began = time.process_time()
    found = reconstruct(dataset, recipe, on_step=on_step)
    seconds = time.process_time() - began
    start = scores(found.initial_volumes, truth)
    fitted = scores(first[0].volume(truth.grid), truth)
    end = scores(found.gaussians.volume(truth.grid), truth)
    channels = score_test_views(dataset, found.gaussians).values()
    away, every = (max(c[name] for c in channels) for name in ("chi_square_away", "chi_square_all"))
    occupied = int(occupied_voxels(truth.volumes).sum()) * len(truth.volumes)
    stored = found.gaussians.numbers
    columns = (" ".join(f"{value:5.2f}" for value in values) for values in (start, fitted, end, end - start))
    told = "".join(f"{column:<24}" for column in columns)
    return (
        f"{label:<{NAMED}}{told}{away:>9.2f}{every:>7.2f}"
        f"{len(found.gaussians):>11}{stored / occupied:>9.2f}{seconds:>7.0f}"
    )


@without_other_pools()
def main() -> None:
    scenes = yaml.safe_load(SCENES.read_text(encoding="utf-8"))
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("scenes", nargs="*", default=list(scenes), metavar="SCENE", help=", ".join(scenes))
    parser.add_argument("--threads", type=int, help="default: all")
    parser.add_argument("--seed", type=int, default=0, help="of the noise")
    parser.add_argument("--kernel", choices=KERNELS, default="interface", help="default: interface")
    parser.add_argument("--residual", action="store_true", help="keep a residual in voxels, with planes")
    parser.add_argument("--halfway", type=float, default=0.0, help="weight of the second grid")
    parser.add_argument("--out", type=Path, help="folder to keep the scans in")
    parser.add_argument("--table", type=Path, default=TABLE, help="file that the rows go to")
    asked = parser.parse_args()
    if unknown := set(asked.scenes) - set(scenes):
        parser.error(f"no scene {', '.join(sorted(unknown))}; there are {', '.join(scenes)}")
    set_threads(asked.threads)
    head = [f"{platform.machine()}, {thread_count()} threads", HEADER]
    print(HEADER)
    with tempfile.TemporaryDirectory() as scratch:
        folder = asked.out or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        for name in asked.scenes:
            kernel = "residual" if asked.residual else asked.kernel
            label = f"{name} seed {asked.seed} {kernel}" + (f" {asked.halfway:g}" if asked.halfway else "")
            with scanned(name, scenes[name], asked.seed, folder / f"{name}-{asked.seed}.h5") as dataset:
                row = row_of(label, dataset, recipe_with(asked.kernel, asked.halfway, asked.residual))
            store(asked.table, head, row, NAMED)
            print(row, flush=True)


if __name__ == "__main__":
    main()
