"""Processor time of a simulation and a fit beside that of an older commit, with their errors.

    python -m benchmarks.older_commit COMMIT [--rounds N] [SCENE ...]

Both trees run the same commands in turns, each in a process of its own with one thread: `phantomgen make SCENE`, and
`recon fit` of the scan that this tree made. A row states the median of the processor seconds of either, the ratio with
the smallest and the largest of all rounds, and the PSNR of the basis volumes of a fit [dB] or the largest measured
error of log projections of a simulation. What a scene does not have, such as motion or a curved panel, must cost it
nothing. The first round compiles kernels and does not count. Rows take the place of those in
`results/older_commit.txt`.
"""

import argparse
import io
import json
import os
import resource
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path
from statistics import median

from benchmarks.result_rows import store

ROOT = Path(__file__).parents[1]
TABLE = Path(__file__).parent / "results" / "older_commit.txt"
SCENES = ("kedge-small",)
NAMED = 24  # characters of a row for its scene and command
HEADER = (
    f"{'scene, command':<{NAMED}}{'before [s]':>11}{'now [s]':>9}{'ratio':>7}{'least':>7}{'most':>7}"
    "  errors before, now"
)


def processor_seconds(tree: Path, arguments: list[str], folder: Path) -> float:
    """Run a program of a tree; seconds of all its threads."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    threads = {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
    caches = {"NUMBA_CACHE_DIR": str(tree / ".numba"), "PYTHONPATH": str(tree)}
    command = [sys.executable, "-m", *arguments, "--overwrite", "-q"]
    subprocess.run(command, cwd=folder, env=os.environ | threads | caches, check=True, stdout=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def checkout(commit: str, folder: Path) -> Path:
    """The files of a commit in a folder."""
    packed = subprocess.run(["git", "-C", str(ROOT), "archive", commit], check=True, capture_output=True).stdout
    with tarfile.open(fileobj=io.BytesIO(packed)) as archive:
        archive.extractall(folder, filter="data")
    return folder


def made_error(path: Path) -> str:
    """Largest error of log projections that a simulation measured."""
    import h5py  # noqa: PLC0415 - threads are set in the processes that are measured

    with h5py.File(path) as file:
        plan = json.loads(file["truth/plan/data"][()])
    return f"{max(plan['measured']['edge_worst'], plan['measured']['ray_worst']):.1e}"


def fit_error(folder: Path) -> str:
    """PSNR of the basis volumes of a run [dB]."""
    metrics = json.loads((folder / "metrics.json").read_text())
    return "/".join(f"{basis['psnr']:.2f}" for basis in metrics["basis"].values())


def rows(scene: str, trees: tuple[Path, Path], rounds: int, folder: Path) -> list[str]:
    """Rows of a simulation and of a fit."""
    scan = f"{scene}.h5"
    commands = {
        "make": lambda name: ["phantomgen", "make", "--preset", scene, "-o", f"{name}-{scan}"],
        "fit": lambda name: ["recon", "fit", f"now-{scan}", "-o", f"{name}-run", "--no-figures", "--threads", "1"],
    }
    found = []
    for command, arguments in commands.items():
        seconds: dict[str, list[float]] = {"before": [], "now": []}
        for turn in range(rounds + 1):
            for name, tree in zip(seconds, trees, strict=True):
                spent = processor_seconds(tree, arguments(name), folder)
                if turn:
                    seconds[name].append(spent)
        ratios = [now / before for before, now in zip(seconds["before"], seconds["now"], strict=True)]
        before, now = (median(values) for values in seconds.values())
        errors = [
            made_error(folder / f"{name}-{scan}") if command == "make" else fit_error(folder / f"{name}-run")
            for name in seconds
        ]
        found.append(
            f"{f'{scene}, {command}':<{NAMED}}{before:>11.1f}{now:>9.1f}{now / before:>7.3f}{min(ratios):>7.3f}"
            f"{max(ratios):>7.3f}  {', '.join(errors)}"
        )
    return found


def main() -> None:
    """Measure and store the rows."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("commit")
    parser.add_argument("scenes", nargs="*", default=list(SCENES), metavar="SCENE")
    parser.add_argument("--rounds", type=int, default=3)
    asked = parser.parse_args()
    print(HEADER)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        trees = checkout(asked.commit, folder / "before"), ROOT
        for scene in asked.scenes:
            for row in rows(scene, trees, asked.rounds, folder):
                print(row, flush=True)
                store(TABLE, [f"before: {asked.commit}", HEADER], row, NAMED)


if __name__ == "__main__":
    main()
