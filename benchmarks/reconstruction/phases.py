"""Phases of a scan in time: fitted together with shared shapes, one by one, and all views as if nothing moved.

    python -m benchmarks.reconstruction.phases perfusion
    python -m benchmarks.reconstruction.phases breathing-torso --phases 0 2 4

PSNR [dB] of each basis against the truth of each phase, whose peak is the largest true value of all phases.
"""

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np

from phantomgen.dataset.reader import Dataset, open_dataset
from phantomgen.dataset.time.true_phases import read_phases
from phantomgen.scene.scan import load_scene
from phantomgen.simulation.run import simulate
from recon.gaussians.fitted_grid import read_with_coverage
from recon.gaussians.recipe import FAST
from recon.gaussians.reconstruct import reconstruct
from recon.phases.fit import fit_phases
from recon.phases.run import AUTO, divide
from recon.phases.settings import PhaseSettings


def decibels(volumes: np.ndarray, true: np.ndarray, peaks: np.ndarray) -> str:
    """PSNR of each basis, separated by slashes."""
    errors = np.square(volumes - true).mean(axis=(1, 2, 3), dtype=np.float64)
    return " / ".join(f"{20 * np.log10(p) - 10 * np.log10(e):.2f}" for p, e in zip(peaks, errors, strict=True))


def alone(dataset: Dataset, phase: np.ndarray, number: int) -> np.ndarray:
    """Volumes of the default fit of the views of one phase."""
    whole = dataset.splits
    dataset.__dict__["splits"] = {**whole, "train": whole["train"][phase == number]}
    try:
        found = reconstruct(dataset, FAST).volumes
    finally:
        dataset.__dict__["splits"] = whole
    assert found is not None
    return found


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("preset")
    parser.add_argument("--phases", type=int, nargs="*", help="those that are fitted alone [default: all]")
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
            how = division.phase, division.cyclic, scan.coverage.grid, FAST, PhaseSettings()
            phases = fit_phases(static.gaussians, scan.measured, *how).volumes(dataset.grid)
            seconds["phases"] = time.perf_counter() - began
            print(f"| phase | all views | phases | phase alone |  ({' / '.join(dataset.spectra.basis.names)})")
            chosen = range(len(true)) if asked.phases is None else asked.phases
            for number in range(len(true)):
                one = "-"
                if number in chosen:
                    began = time.perf_counter()
                    one = decibels(alone(dataset, division.phase, number), true[number], peaks)
                    seconds["phase alone"] = time.perf_counter() - began
                found = decibels(static.volumes, true[number], peaks), decibels(phases[number], true[number], peaks)
                print(f"| {number} | {found[0]} | {found[1]} | {one} |", flush=True)
            print(", ".join(f"{name} {value:.0f} s" for name, value in seconds.items()))


if __name__ == "__main__":
    main()
