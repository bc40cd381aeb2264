"""Phases of a scan in time: fitted together with shared shapes, one by one, as their mean, and all views as one.

    python -m benchmarks.reconstruction.phases perfusion
    python -m benchmarks.reconstruction.phases breathing-torso

PSNR [dB] of each basis against the truth of each phase, whose peak is the largest true value of all phases; then the
mean over all phases.
"""

import argparse
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from phantomgen.dataset.reader import open_dataset
from phantomgen.dataset.time.true_phases import read_phases
from phantomgen.scene.scan import load_scene
from phantomgen.simulation.run import simulate
from recon.gaussians.fitted_grid import read_with_coverage
from recon.gaussians.recipe import FAST
from recon.gaussians.reconstruct import reconstruct
from recon.phases.alone import with_phases_alone, with_unseen_rays_of_phases
from recon.phases.fit import fit_phases
from recon.phases.run import AUTO, divide
from recon.phases.settings import PhaseSettings


def psnr(volumes: np.ndarray, true: np.ndarray, peaks: np.ndarray) -> np.ndarray:
    """PSNR of each basis [dB]."""
    errors = np.square(volumes - true).mean(axis=(1, 2, 3), dtype=np.float64)
    return 20 * np.log10(peaks) - 10 * np.log10(errors)


def row(name: str, decibels: Sequence[np.ndarray], weight: str) -> str:
    """Row of the table."""
    whole, together, alone, phases = (" / ".join(f"{value:.1f}" for value in each) for each in decibels)
    return f"| {name} | {whole} | {together} | {alone} | {weight} | {phases} |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("preset")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scan.h5"
        simulate(load_scene(asked.preset), path)
        with open_dataset(path) as dataset:
            true, division = read_phases(path), divide(dataset, AUTO)
            assert true is not None
            peaks, seconds = true.max(axis=(0, 2, 3, 4)), {}
            began = time.perf_counter()
            static = reconstruct(dataset, FAST)
            assert static.volumes is not None
            seconds["all views"] = time.perf_counter() - began
            began = time.perf_counter()
            scan = read_with_coverage(dataset, FAST)
            phase, grid = division.phase, scan.coverage.grid
            measured = with_unseen_rays_of_phases(scan.measured, phase, min(dataset.grid.spacing), FAST)
            shared = fit_phases(static.gaussians, measured, phase, division.cyclic, grid, FAST, PhaseSettings())
            seconds["phases with shared shapes"] = time.perf_counter() - began
            kept = with_phases_alone(shared, dataset, measured, phase, grid, FAST)
            seconds["phases"] = time.perf_counter() - began
            print(" / ".join(dataset.spectra.basis.names))
            print("| phase | all views | together | alone | weight of alone | phases |", flush=True)
            decibels = []
            for number, wanted in enumerate(true):
                weight = kept.alone[number].weight if number in kept.alone else 0.0
                own = kept.alone[number].gaussians.volume(dataset.grid) if weight else np.full_like(wanted, np.nan)
                each = static.volumes, shared.volume(number, dataset.grid), own, kept.volume(number, dataset.grid)
                decibels.append([psnr(volumes, wanted, peaks) for volumes in each])
                print(row(str(number), decibels[-1], f"{weight:.2f}"), flush=True)
            print(row("mean", np.mean(decibels, axis=0), ""))
            print(", ".join(f"{name} {value:.0f} s" for name, value in seconds.items()))


if __name__ == "__main__":
    main()
