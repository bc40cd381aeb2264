"""Time and memory of `phantomgen make` against views, channels, pixels and voxels: all are linear.

    python -m benchmarks.simulator.scaling          # a quarter of an hour python -m benchmarks.simulator.scaling large
    # a part of a scan of 720 views x 5 channels x 1024 x 1024, 512^3 voxels

Every line is a process of its own with one thread. Seconds are those of the processor, so that other programs disturb
little, after a first tiny scan that loads all kernels. Memory is the peak of the whole process, libraries included.
A straight line is fitted to each table; `off` is the largest deviation from it, in parts of the largest value.
"""

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from phantomgen.scene.scan import load_scene
from phantomgen.simulation.run import simulate
from spectra.threads import set_threads

BASE = {"views": 8, "channels": 4, "pixels": 256, "voxels": 64}
TABLES = {
    "views": [8, 16, 32, 64, 128],
    "channels": [1, 2, 4, 8, 16],
    "pixels": [128, 256, 512, 1024],
    "voxels": [64, 128, 256, 384],
}
LARGE = {"views": 6, "channels": 5, "pixels": 1024, "voxels": 512}
LARGE_VIEWS = [6, 12, 24]


def point(views: int, channels: int, pixels: int, voxels: int) -> dict:
    """Simulate a kedge scan of this size; seconds per stage, and memory [MiB]."""
    set_threads(1)
    thresholds = np.linspace(20, 110, channels).round(2).tolist()
    overrides = [
        f"geometry.views={views}",
        "geometry.test_views=0",
        f"panel.rows={pixels}",
        f"panel.columns={pixels}",
        f"panel.pitch={0.8 * 256 / pixels}",
        f"volume.voxels={voxels}",
        f"detector.thresholds={thresholds}",
        "flats=1",
    ]
    tiny = ["panel.rows=8", "panel.columns=8", "panel.pitch=25.6", "volume.voxels=4", "geometry.views=1"]
    with tempfile.TemporaryDirectory() as folder:
        simulate(load_scene("kedge", [*overrides, *tiny]), Path(folder) / "tiny.h5")
        scan, began = load_scene("kedge", overrides), time.process_time()
        summary = simulate(scan, Path(folder) / "scan.h5")
        return {
            "seconds": time.process_time() - began,
            "stages": {name: round(seconds, 2) for name, seconds in summary.seconds.items()},
            "bytes": summary.size,
            "mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        }


def measured(size: dict[str, int]) -> dict:
    """The same in a process of its own."""
    command = [sys.executable, "-m", "benchmarks.simulator.scaling", "point", json.dumps(size)]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    result = subprocess.run(command, check=True, capture_output=True, text=True, env=environment)
    return json.loads(result.stdout.splitlines()[-1])


def show(name: str, values: list[int], base: dict[str, int]) -> None:
    """One table, and the line through it."""
    size = ", ".join(f"{value} {key}" for key, value in base.items() if key != name)
    print(f"\n{name}, with {size}\n{name:>10}{'CPU [s]':>10}{'peak [MiB]':>12}{'file [MB]':>11}  stages [s, wall]")
    rows = []
    for value in values:
        found = measured({**base, name: value})
        rows.append((found["seconds"], found["mib"]))
        stages = ", ".join(f"{stage} {seconds:g}" for stage, seconds in found["stages"].items())
        print(f"{value:>10}{rows[-1][0]:>10.2f}{rows[-1][1]:>12.0f}{found['bytes'] / 1e6:>11.1f}  {stages}", flush=True)
    power = {"pixels": 2, "voxels": 3}.get(name, 1)
    unit = {"pixels": "per Mpixel", "voxels": "per 10^6 voxels"}.get(name, f"per {name.removesuffix('s')}")
    x = np.array(values, dtype=float) ** power / (1e6 if power > 1 else 1)
    for what, y in zip(("CPU [s]", "peak [MiB]"), np.array(rows).T, strict=True):
        slope, intercept = np.polyfit(x, y, 1)
        off = np.abs(slope * x + intercept - y).max() / y.max()
        print(f"  {what:<11}{slope:10.4g} {unit} + {intercept:.4g}, off {off:.1%}", flush=True)


def main() -> None:
    """All tables, or what was asked for."""
    if sys.argv[1:2] == ["point"]:
        print(json.dumps(point(**json.loads(sys.argv[2]))))
    elif sys.argv[1:2] == ["large"]:
        show("views", LARGE_VIEWS, LARGE)
    else:
        for name, values in TABLES.items():
            show(name, values, BASE)


if __name__ == "__main__":
    main()
