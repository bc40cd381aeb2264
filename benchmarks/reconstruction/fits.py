"""Accuracy and time of `recon fit` on several presets, each with several seeds of the noise and of the fit.

    python -m benchmarks.reconstruction.fits [--out FOLDER] [--kernel NAME] [--seeds N] [PRESET[=RECIPE] ...]

PSNR [dB] and worst SSIM of the basis volumes; chi-square of test views in the worst channel, away from edges and of all
rays; seconds up to the last step; processor time of the whole command, scores included, which does not depend on what
else the machine does. A row `truth` has chi-square of the true volumes: what voxels miss at edges, and what the basis
misses of real materials. Rows take the place of those in `results/fits.txt`. Runs of the first seed are kept in FOLDER,
for `recon segment` and `recon report`.
"""

import argparse
import json
import os
import platform
import resource
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import phantomgen
from benchmarks.result_rows import store
from phantomgen.dataset.truth import read_truth
from recon.evaluation.scoring import score_test_views
from recon.gaussians.recipe import KERNELS, RECIPES
from recon.voxel.model import Voxels
from spectra.threads import thread_count

PRESETS = ("kedge", "multi-energy", "bird-chest", "metal-hip")
SEEDS = (0, 1, 2)
TABLE = Path(__file__).parents[1] / "results" / "fits.txt"
NAMES = f"{'preset':<14}{'recipe':<8}{'kernel':<11}{'seed':<6}"
HEADER = f"{NAMES}{'PSNR':<24}{'SSIM':>5}{'off edges':>11}{'all':>8}{'s':>6}{'CPU s':>7}{'MiB':>6}{'Gaussians':>11}"
AFTER = ("score", "write", "figures")  # stages that do not count


def datasets(preset: str, folder: Path, seeds: int) -> Iterator[tuple[int, Path]]:
    """Scans that differ in their noise alone; only the first is traced, unless it is in the folder."""
    scan, first = phantomgen.load(preset), folder / f"{preset}.h5"
    if not first.exists():
        phantomgen.make(scan, first, seed=SEEDS[0], keep_paths=seeds > 1).close()
    yield SEEDS[0], first
    for seed in SEEDS[1:seeds]:
        other = folder / f"{preset}-{seed}.h5"
        phantomgen.make(
            scan, other, seed=seed, overwrite=True, options=phantomgen.SimulationOptions(paths=first)
        ).close()
        yield seed, other
        other.unlink()


def fitted(dataset: Path, recipe: str, kernel: str, seed: int, run: Path) -> tuple[dict[str, Any], float]:
    """Scores of a fit by the command line, and its processor time."""
    began = resource.getrusage(resource.RUSAGE_CHILDREN)
    options = ["--recipe", recipe, "--kernel", kernel, "--seed", str(seed), "--out", str(run), "--overwrite", "--quiet"]
    subprocess.run(
        [sys.executable, "-m", "recon", "fit", str(dataset), *options], check=True, stdout=subprocess.DEVNULL
    )
    ended = resource.getrusage(resource.RUSAGE_CHILDREN)
    seconds = ended.ru_utime + ended.ru_stime - began.ru_utime - began.ru_stime
    return json.loads((run / "metrics.json").read_text(encoding="utf-8")), seconds


def row_of(name: str, scores: dict[str, Any], processor: float) -> str:
    """One line of the results."""
    psnr = "  ".join(f"{basis['psnr']:5.2f}" for basis in scores["basis"].values())
    ssim = min(basis["ssim"] for basis in scores["basis"].values())
    seconds = sum(time for stage, time in scores["seconds"].items() if stage not in AFTER)
    return (
        f"{name}{psnr:<24}{ssim:5.3f}{chi_square_cell(scores['channels'])}{seconds:6.0f}{processor:7.0f}"
        f"{scores['peak_memory_mib']:6.0f}{scores['gaussians']:11d}"
    )


def chi_square_cell(channels: dict[str, Any]) -> str:
    """Chi-square of the worst channel, away from edges and of all rays."""
    away, everywhere = (max(c[f"chi_square_{rays}"] for c in channels.values()) for rays in ("away", "all"))
    return f"{away:11.3f}{everywhere:8.2f}"


def row_of_truth(name: str, dataset: Path) -> str:
    """The same of the true volumes."""
    truth = read_truth(dataset)
    assert truth is not None
    with phantomgen.open(dataset) as opened:
        channels = score_test_views(opened, Voxels(truth.volumes, truth.grid, truth.basis_names))
    return f"{name}{'-':<24}{'-':>5}{chi_square_cell(channels)}"


def keep(row: str) -> None:
    store(TABLE, [f"{platform.machine()}, {thread_count()} threads", HEADER], row, len(NAMES))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("presets", nargs="*", default=PRESETS, metavar="PRESET[=RECIPE]")
    parser.add_argument("--kernel", choices=KERNELS, default="interface", help="default: interface")
    parser.add_argument("--seeds", type=int, default=len(SEEDS), help="how many of the seeds, default: all")
    parser.add_argument("--out", type=Path, help="folder to keep datasets and runs of the first seed in")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = asked.out or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        for preset, _, recipe in (word.partition("=") for word in asked.presets):
            for seed, dataset in datasets(preset, folder, asked.seeds):
                if seed == SEEDS[0]:
                    keep(row_of_truth(f"{preset:<14}{'truth':<19}{seed:<6d}", dataset))
                for chosen in [recipe] if recipe else RECIPES:
                    run = folder / f"{preset}-{chosen}-{asked.kernel}" if seed == SEEDS[0] else Path(scratch) / "run"
                    scores, processor = fitted(dataset, chosen, asked.kernel, seed, run)
                    row = row_of(f"{preset:<14}{chosen:<8}{asked.kernel:<11}{seed:<6d}", scores, processor)
                    keep(row)
                    print(f"{row}  ({os.getloadavg()[0]:.1f} busy)", flush=True)


if __name__ == "__main__":
    main()
