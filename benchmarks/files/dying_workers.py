"""A batch of many scenes whose workers are killed at random moments (SIGKILL), beside one that nothing disturbs.

    python -m benchmarks.files.dying_workers [--items 1000] [--seconds 10] [--seed 0]

Items are small scans of one scene with other seeds, made by two workers. One of the workers is killed after a time that
is exponentially distributed with the mean `--seconds`, again and again. Where the batch ends with items missing, it is
run once more, with its workers killed as well. The table states how many items are there after each run, how many
workers were killed, and how many datasets have the bytes of those of the undisturbed batch.
"""

import argparse
import contextlib
import hashlib
import os
import signal
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.files.kills import start

SCENE = """\
version: 1
name: dying
source: {type: lines, lines: {40: 1, 60: 1, 80: 1}, photons: 1.0e4}
detector: {type: photon_counting, thresholds: [20, 50]}
geometry: {type: circular, sod: 100, sdd: 200, views: 4, test_views: 1}
panel: {rows: 8, columns: 8, pitch: 8}
volume: {voxels: 8, size: 30}
materials: {water: {composition: H2O, density: 1.0}}
objects:
  - {type: sphere, material: water, radius: {uniform: [5, 12]}}
"""
WORKERS = 2
MOST_RUNS = 10
BATCH = ("phantomgen", "batch", "batch.yaml", "--workers", str(WORKERS), "-q", "-o", "{out}")


def workers_of(process: int) -> list[int]:
    """Processes that this process started and that work on items, as Linux lists them."""
    children = Path(f"/proc/{process}/task/{process}/children").read_text(encoding="ascii").split()
    commands = {int(child): Path(f"/proc/{child}/cmdline").read_bytes() for child in children}
    return [child for child, command in commands.items() if b"resource_tracker" not in command]


def disturbed(folder: Path, out: Path, seconds: float, random: np.random.Generator) -> int:
    """Run the batch, and kill one of its workers again and again; how many were killed."""
    process, killed = start(BATCH, out, folder), 0
    while True:
        try:
            process.wait(random.exponential(seconds))
            return killed
        except subprocess.TimeoutExpired:
            with contextlib.suppress(OSError):  # a worker that has just ended
                for worker in random.permutation(workers_of(process.pid))[:1]:
                    os.kill(int(worker), signal.SIGKILL)
                    killed += 1
        except BaseException:
            process.kill()
            raise


def datasets(folder: Path) -> dict[str, str]:
    """Digest of each dataset."""
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(folder.glob("*.h5"))}


def main() -> None:
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--items", type=int, default=1000)
    parser.add_argument("--seconds", type=float, default=10.0, help="between two kills, on average")
    parser.add_argument("--seed", type=int, default=0, help="of the kills")
    asked = parser.parse_args()
    random = np.random.default_rng(asked.seed)
    print(f"{asked.items} items, {WORKERS} workers, a kill every {asked.seconds:g} s on average, seed {asked.seed}")
    print(f"{'run':<14}{'seconds':>9}{'killed':>9}{'there':>9}{'equal':>9}")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "scene.yaml").write_text(SCENE, encoding="utf-8")
        manifest = f"{{version: 1, scene: scene.yaml, count: {asked.items}}}\n"
        (folder / "batch.yaml").write_text(manifest, encoding="utf-8")
        began = time.perf_counter()
        process = start(BATCH, folder / "whole", folder)
        message = process.communicate()[1].decode()
        if process.returncode:
            raise SystemExit(f"the undisturbed batch ended with {process.returncode}: {message}")
        wanted = datasets(folder / "whole")
        print(
            f"{'undisturbed':<14}{time.perf_counter() - began:>9.0f}{0:>9}{len(wanted):>9}{len(wanted):>9}", flush=True
        )
        for run in range(MOST_RUNS):
            began = time.perf_counter()
            killed = disturbed(folder, folder / "disturbed", asked.seconds, random)
            found = datasets(folder / "disturbed")
            equal = sum(wanted[item] == digest for item, digest in found.items())
            seconds = time.perf_counter() - began
            print(f"{f'disturbed {run + 1}':<14}{seconds:>9.0f}{killed:>9}{len(found):>9}{equal:>9}", flush=True)
            if len(found) == asked.items:
                break


if __name__ == "__main__":
    main()
