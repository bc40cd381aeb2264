"""Flips random bits of a dataset, one at a time: how many does `phantomgen validate` notice?

    python -m benchmarks.files.bit_flips [--flips 1000] [--seed 0]

A small scan is written with and without compression. Each flip is made in a copy and is

- noticed: `validate` names a problem, or refuses to open the file;
- harmless: everything that is in the file, every attribute, text and number, is still the same;
- unnoticed: something differs, and `validate` says that the file is valid;
- a crash: the process ends or hangs, as HDF5 does on some bytes; nothing is returned then.
"""

import argparse
import os
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from select import select

import h5py
import numpy as np

from phantomgen.dataset.validate import validate
from phantomgen.scene.file.scene_file import SceneFile
from phantomgen.scene.scan import load_scene
from phantomgen.simulation.run import simulate
from spectra.errors import Error

PATIENCE = 30.0  # s
OUTCOMES = ("noticed", "harmless", "unnoticed", "crash")
SCENE = """\
version: 1
name: flips
source: {type: tube, kvp: 120, photons: 1e4, filters: [{composition: Al, thickness: 3}]}
detector: {type: photon_counting, thresholds: [20, 50]}
geometry: {type: circular, sod: 100, sdd: 200, views: 12, test_views: 4}
panel: {rows: 12, columns: 16, pitch: 2}
volume: {voxels: 12, size: 20}
materials: {water: {composition: H2O, density: 1.0}, bone: {composition: Ca, density: 1.0}}
objects:
  - {type: cylinder, material: water, radius: 8, length: 13}
  - {type: sphere, material: bone, radius: 3, center: [2, 1, 0]}
flats: 2
"""


def write_scan(path: Path, compression: str) -> None:
    """Simulate the scan."""
    simulate(load_scene(SceneFile("flips.yaml", SCENE)), path, compression=compression)


def outcomes(path: Path, bits: list[int]) -> Iterator[str]:
    """Outcome of each flip, in processes that may crash."""
    worker = None
    for bit in bits:
        if worker is None:
            command = [sys.executable, "-m", "benchmarks.files.bit_flips", "--worker", str(path)]
            worker = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, bufsize=0
            )
        worker.stdin.write(f"{bit}\n".encode())
        ready = select([worker.stdout], [], [], PATIENCE)[0]
        answer = worker.stdout.readline().decode().strip() if ready else ""
        yield answer or "crash"
        if not answer:
            worker.kill()
            worker.communicate()
            worker = None
    if worker is not None:
        worker.communicate()


def work(path: Path) -> None:
    """Answer flips on stdin, one after the other."""
    whole, wanted = path.read_bytes(), contents(path)
    copy = path.with_name(f"{path.stem}-{os.getpid()}.h5")
    try:
        for line in sys.stdin:
            place, bit = divmod(int(line), 8)
            copy.write_bytes(whole[:place] + bytes([whole[place] ^ 1 << bit]) + whole[place + 1 :])
            try:
                noticed = bool(validate(copy))
            except Error:
                noticed = True
            except Exception as error:  # a bug
                print(f"traceback {type(error).__name__}", flush=True)
                continue
            print("noticed" if noticed else "harmless" if contents(copy) == wanted else "unnoticed", flush=True)
    finally:
        copy.unlink(missing_ok=True)


def contents(path: Path) -> dict[str, str] | None:
    """All attributes, links and values of a file, without the digests; None where something cannot be read."""
    found = {}

    def value(item: object) -> str:
        array = np.asarray(item)
        return repr((str(array.dtype), array.shape, array.tolist() if array.dtype.kind == "O" else array.tobytes()))

    def add(item: h5py.Group | h5py.Dataset) -> None:
        name = str(item.name)
        for key in item.attrs:
            if key != "digests":
                found[f"{name}@{key}"] = value(item.attrs[key])
        if isinstance(item, h5py.Dataset):
            found[name] = value(item[()])
            return
        for below in item:
            link = item.get(below, getlink=True)
            if isinstance(link, h5py.SoftLink):
                found[f"{name}/{below}"] = link.path
            else:
                add(item[below])

    try:
        with h5py.File(path) as file:
            add(file)
    except Exception:
        return None
    return found


def table(flips: int, seed: int, folder: Path, compressions: tuple[str, ...] = ("gzip", "none")) -> dict[str, Counter]:
    """Count the outcomes."""
    found = {}
    for compression in compressions:
        path = folder / f"{compression}.h5"
        if not path.exists():
            write_scan(path, compression)
        bits = np.random.default_rng(seed).integers(0, 8 * path.stat().st_size, flips)
        found[compression] = Counter(outcomes(path, bits.tolist()))
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--flips", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--worker", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.worker:
        work(arguments.worker)
        return
    with tempfile.TemporaryDirectory() as name:
        found = table(arguments.flips, arguments.seed, Path(name))
    print(f"{arguments.flips} flips, seed {arguments.seed}")
    print("compression " + "".join(f"{outcome:>11}" for outcome in OUTCOMES))
    for compression, counts in found.items():
        print(f"{compression:<12}" + "".join(f"{counts.pop(outcome, 0):>11}" for outcome in OUTCOMES), *counts.items())


if __name__ == "__main__":
    main()
