"""Settings of the methods that Gaussians are compared with, as they follow counts free of partial volume.

    python -m benchmarks.reconstruction.comparison_methods [metal | implant | pin | z_aligned] [METHOD ...]

PSNR [dB] of the basis volumes and their mean, and processor time, on `development.yaml` or one of its siblings with
64^3 voxels, 45 views and pixels of a voxel. Settings are named by what differs from the defaults; the method runs once
for all numbers of iterations. Rows take the place of those in `results/comparison_methods.txt`. No preset takes part.
"""

import platform
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import phantomgen
from benchmarks.result_rows import store
from phantomgen.dataset.reader import open_dataset
from phantomgen.dataset.truth import Truth, read_truth
from phantomgen.runtime.stopwatch import Stopwatch
from recon.data.measurements import Measurements, read_measurements
from recon.evaluation.metrics import psnr
from recon.gaussians.recipe import Recipe
from recon.runs.methods import method_named
from recon.runs.run_voxels import reconstruct_volumes
from recon.voxel.method import Iteration, no_callback
from spectra.threads import thread_count, without_other_pools

FOLDER = Path(__file__).parents[1]
TABLE = FOLDER / "results" / "comparison_methods.txt"
SCENES = ("metal", "implant", "pin", "z_aligned")
SMALLER = ["volume.voxels=64", "geometry.views=45", "panel.rows=128", "panel.columns=128", "panel.pitch=1.6"]
NAMES = "{:<15}{:<10}{:<44}"  # scene, method, settings
HEADER = f"{NAMES.format('scene', 'method', 'settings')}   PE  Compton  K edge  mean   CPU s"


@dataclass(frozen=True)
class Setting:
    """A method with some of its numbers changed.

    Parameters
    ----------
    method : as `recon fit --method` has it
    changes : fields that differ from the defaults
    at : iterations to score; the last one where there are none
    """

    method: str
    changes: dict[str, Any]
    at: tuple[int, ...] = ()

    def name(self, iterations: int | None = None) -> str:
        """What differs, in words."""
        unsaid = ("iterations", "levels", "tolerance")
        words = [f"{key} {value}" for key, value in self.changes.items() if key not in unsaid]
        passes = f"{self.changes['levels'][-1][1]} passes" if "levels" in self.changes else ""
        times = f"{iterations} iterations" if iterations else passes
        return ", ".join(word for word in [*words, times] if word) or "defaults"


def levels(passes: int) -> tuple[tuple[int, int], ...]:
    return (4, 8), (2, 8), (1, passes)


SETTINGS = (
    *(Setting("fdk", {"window": window}) for window in ("ram-lak", "shepp-logan", "cosine", "hann")),
    *(
        Setting("sart", {"relaxation": relaxation, "decay": decay, "iterations": 8}, (2, 3, 4, 6, 8))
        for relaxation, decay in ((1.0, 0.5), (1.0, 0.7), (1.0, 0.85), (0.7, 0.7))
    ),
    Setting("cgls", {"iterations": 20}, (6, 8, 10, 12, 16, 20)),
    Setting("sirt", {"iterations": 160}, (40, 60, 80, 120, 160)),
    Setting("one-step", {}),
    *(Setting("one-step", {"strength": strength}) for strength in (0.5, 0.7, 1.0, 2.0, 3.0)),
    *(Setting("one-step", {"levels": levels(passes)}) for passes in (5, 16)),
    *(Setting("one-step", {"dispersion": dispersion}) for dispersion in (0.02, 0.05)),
    *(
        Setting("pdhg-tv", {"strength": strength, "iterations": 100, "tolerance": 0.0}, (100,))
        for strength in (1.0, 2.0, 3.0, 4.0, 6.0, 8.0)
    ),
)


def scored(setting: Setting, measured: Measurements, truth: Truth) -> Iterator[tuple[str, np.ndarray, float]]:
    """Name, PSNR of the bases and processor time of each number of iterations."""
    found: list[tuple[str, np.ndarray, float]] = []
    began, paused = time.process_time(), 0.0

    def score(name: str, volumes: np.ndarray) -> None:
        nonlocal paused
        reached = time.process_time()
        pairs = zip(volumes, truth.volumes, strict=True)
        scores = np.array([psnr(float(t.max()), float(np.mean((v - t) ** 2))) for v, t in pairs])
        found.append((name, scores, reached - began - paused))
        paused += time.process_time() - reached

    def watch(state: Iteration) -> None:
        if state.done in setting.at:
            score(setting.name(state.done), state.volumes)

    method: Any = replace(method_named(setting.method), **setting.changes)  # type: ignore[type-var]
    told = watch if setting.at else no_callback
    volumes = reconstruct_volumes(measured, truth.grid, method, "two-step", Stopwatch(), told)
    if not setting.at:
        score(setting.name(), volumes)
    yield from found


@without_other_pools()
def main(words: list[str]) -> None:
    scene = words[0] if words and words[0] in SCENES else ""
    methods = words[1:] if scene else words
    suffix = f"_{scene}" if scene else ""
    scan = phantomgen.load(FOLDER / "scenes" / f"development{suffix}.yaml", SMALLER)
    head = [f"{platform.machine()}, {thread_count()} threads; 64^3 voxels, 45 views of 128 x 128 pixels", HEADER]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scan.h5"
        phantomgen.make(scan, path).close()
        truth = read_truth(path)
        assert truth is not None
        with open_dataset(path) as dataset:
            measured = read_measurements(dataset, dataset.splits["train"]).without_partial_volume()
            measured, _ = measured.compressed(Recipe().node_tolerance)
        for setting in (s for s in SETTINGS if not methods or s.method in methods):
            for name, scores, seconds in scored(setting, measured, truth):
                numbers = "  ".join(
                    f"{score:5.2f}" for score in [*scores, *[np.nan] * (3 - len(scores)), scores.mean()]
                )
                row = f"{NAMES.format('tuning' + suffix, setting.method, name)}{numbers}  {seconds:6.1f}"
                store(TABLE, head, row, len(NAMES.format("", "", "")))
                print(row, flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
