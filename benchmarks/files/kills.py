"""Kills commands at random moments (SIGKILL), resumes them, and compares with what an uninterrupted run writes.

    python -m benchmarks.files.kills [--kills 25] [--seed 0] [--only make,fit]

Each command works on a small scene or scan, with one thread. A trial starts the command, kills it at a moment that is
uniform over the time of an uninterrupted run, and resumes it; every third trial kills the resumed run once more. It is

- equal: the last run ends without an error, and everything that it wrote is that of the uninterrupted run, but for
  seconds, memory and the folder's name;
- different: it ends without an error, but a file is missing, or holds something else;
- failed: the resumed run ends with an error.

`ended` counts kills that came when the whole output had its name. `recon compare` gives its methods a budget that
none of them needs, as results of a method that is stopped by a budget depend on the speed of the machine.
"""

import argparse
import hashlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

SCENE = """\
version: 1
name: kills
source: {type: tube, kvp: 100, photons: 1.0e4, filters: [{composition: Al, thickness: 3}]}
detector: {type: photon_counting, thresholds: [20, 40, 60]}
geometry: {type: circular, sod: 100, sdd: 200, views: 40, test_views: 8}
panel: {rows: 48, columns: 48, pitch: 1.5}
volume: {voxels: 32, size: 30}
materials: {water: {composition: H2O, density: 1.0}, bone: {composition: Ca, density: 1.0}}
objects:
  - {type: cylinder, material: water, radius: 10, length: 20}
  - {type: sphere, material: bone, radius: 3, center: [2, 1, 0]}
flats: 4
"""
MANIFEST = "{version: 1, scene: scene.yaml, count: 6}\n"
VARIES = ("seconds", "memory", "time", "curve")  # words in keys of JSON; points of a curve are taken at moments


@dataclass(frozen=True)
class Command:
    """A command that is killed.

    Attributes
    ----------
    words : tuple of str
        What follows ``python -m``; ``{out}`` is replaced by the output.
    resume : tuple of str
        What is added to resume it.
    files : callable
        Files below the output whose contents are compared.
    """

    words: tuple[str, ...]
    resume: tuple[str, ...]
    files: Callable[[Path], Iterator[Path]]


def all_files(out: Path) -> Iterator[Path]:
    """Yield the output, or the files below it."""
    yield from ([out] if out.is_file() else sorted(path for path in out.rglob("*") if path.is_file()))


def steady_files(out: Path) -> Iterator[Path]:
    """Yield the files below the output but for logs, pictures and tables of seconds."""
    yield from (path for path in all_files(out) if path.suffix in {".safetensors", ".h5", ".json", ".yaml", ".npy"})


COMMON = ("-q", "-o", "{out}")
RESUME = ("--resume",)
COMMANDS = {
    "make": Command(("phantomgen", "make", "scene.yaml", "--threads", "1", *COMMON), RESUME, all_files),
    "batch": Command(("phantomgen", "batch", "batch.yaml", "--workers", "1", *COMMON), (), steady_files),
    "fit": Command(("recon", "fit", "scan.h5", "--threads", "1", "--sweeps", "4", *COMMON), RESUME, steady_files),
    "compare": Command(
        ("recon", "compare", "scan.h5", "--threads", "1", "--methods", "fdk,cgls,sart", "--budget", "300s", *COMMON),
        RESUME,
        steady_files,
    ),
}


def contents(command: Command, out: Path) -> dict[str, str]:
    """Digest of each file that is compared; of JSON, the values that do not vary from run to run."""
    found = {}
    for path in command.files(out):
        content = path.read_bytes()
        if path.suffix == ".json":
            content = json.dumps(steady(json.loads(content)), sort_keys=True).encode()
        found[str(path.relative_to(out))] = hashlib.sha256(content).hexdigest()
    return found


def steady(value: object) -> object:
    """Leave out the entries of a JSON document whose keys say that they vary from run to run."""
    if isinstance(value, dict):
        return {key: steady(item) for key, item in value.items() if not any(word in key for word in VARIES)}
    return [steady(item) for item in value] if isinstance(value, list) else value


def start(words: tuple[str, ...], out: Path, folder: Path) -> subprocess.Popen:
    """Start a command in the folder, with the date of the files fixed."""
    environment = {**os.environ, "SOURCE_DATE_EPOCH": "0", "OMP_NUM_THREADS": "1"}
    return subprocess.Popen(
        [sys.executable, "-m", *(word.replace("{out}", str(out)) for word in words)],
        cwd=folder,
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        start_new_session=True,
    )


def killed(words: tuple[str, ...], out: Path, folder: Path, seconds: float) -> bool:
    """Start a command, and kill it with all its processes after that time; whether it still ran."""
    process = start(words, out, folder)
    try:
        process.wait(seconds)
        return False
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, 9)
        return True
    finally:
        process.communicate()


def trial(command: Command, out: Path, folder: Path, moments: list[float], wanted: dict[str, str]) -> str:
    """Outcome of one trial."""
    if not killed(command.words, out, folder, moments[0]) or (out.exists() and contents(command, out) == wanted):
        return "ended"
    words = command.words + command.resume
    for moment in moments[1:]:
        killed(words, out, folder, moment)
        if out.exists() and contents(command, out) == wanted:
            return "equal"
    process = start(words, out, folder)
    message = process.communicate()[1].decode()
    if process.returncode != 0 or "Error:" in message:
        print("  ", " ".join(words), moments, message.strip()[-300:], file=sys.stderr)
        return "failed"
    found = contents(command, out)
    if found != wanted:
        differ = sorted(name for name in found.keys() | wanted.keys() if found.get(name) != wanted.get(name))
        print("  ", " ".join(words), moments, "differ:", *differ, file=sys.stderr)
    return "equal" if found == wanted else "different"


def trials(name: str, kills: int, seed: int, folder: Path) -> tuple[Counter, float]:
    """Outcomes of all trials of a command, and seconds of an uninterrupted run."""
    command, suffix = COMMANDS[name], ".h5" if name == "make" else ""
    random = np.random.default_rng((seed, sorted(COMMANDS).index(name)))
    for number in range(2):  # the first run compiles
        begin = time.perf_counter()
        out = folder / f"{name}-whole{number}{suffix}"
        process = start(command.words, out, folder)
        message = process.communicate()[1].decode()
        if process.returncode != 0:
            raise SystemExit(f"{name} without a kill: {message}")
    seconds = time.perf_counter() - begin
    wanted = contents(command, out)
    if wanted != contents(command, folder / f"{name}-whole0{suffix}"):
        raise SystemExit(f"two uninterrupted runs of {name} differ")
    outcomes: Counter = Counter()
    for number in range(kills):
        moments = random.uniform(0, seconds, 1 + (number % 3 == 2)).tolist()
        outcomes[trial(command, folder / f"{name}-{number}{suffix}", folder, moments, wanted)] += 1
    return outcomes, seconds


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=25, help="trials of each command")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default=",".join(COMMANDS), help="commands, separated by commas")
    arguments = parser.parse_args()
    columns = ("equal", "different", "failed", "ended")
    print(f"{arguments.kills} trials of each command, seed {arguments.seed}")
    print(f"{'command':<10}{'seconds':>9}" + "".join(f"{column:>11}" for column in columns))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "scene.yaml").write_text(SCENE)
        (folder / "batch.yaml").write_text(MANIFEST)
        start(("phantomgen", "make", "scene.yaml", "-q", "-o", "{out}"), folder / "scan.h5", folder).communicate()
        for command in arguments.only.split(","):
            outcomes, seconds = trials(command, arguments.kills, arguments.seed, folder)
            print(
                f"{command:<10}{seconds:>9.1f}" + "".join(f"{outcomes[column]:>11}" for column in columns), flush=True
            )


if __name__ == "__main__":
    main()
