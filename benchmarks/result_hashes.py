"""Hashes of what small scans and fits compute: a change of the code that should not change results is checked by them.

    python -m benchmarks.result_hashes /tmp/before.txt                   record
    python -m benchmarks.result_hashes /tmp/after.txt --against /tmp/before.txt
    python -m benchmarks.result_hashes /tmp/part.txt --only kedge --only effects.blur

One line per array or group of arrays: case, what was hashed, the first digits of SHA-256. Cases are every preset and
every effect, coarsened to 9 views of 32 x 32 pixels and 16^3 voxels; of each, counts, truth and the volumes of four
methods. Hashes hold for one machine, one set of packages and one number of threads (one here); numba may compile a
changed kernel to other instructions.
"""

import argparse
import hashlib
import os
import sys
import tempfile
import time
from importlib import resources
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import h5py
import numpy as np
import yaml
from click.testing import CliRunner
from tqdm import tqdm

from phantomgen.cli.main import main as phantomgen
from recon.cli.main import main as recon

METHODS = ("gaussian", "one-step", "sart", "fdk")
COARSE = ("geometry.test_views=3", "flats=5")
PIXELS = 32
EFFECTS = {
    "effects.tube_output": "{sigma: 0.01}",
    "effects.focal_spot": "{width: 0.6, height: 0.9, shape: gaussian}",
    "effects.aperture": "{width: 0.9}",
    "effects.scatter.kernel": "{type: kernel, ratio: 0.3, width: 60}",
    "effects.scatter.compton": "{type: compton}",
    "effects.blur": "{fwhm: 8}",
    "effects.gain": "{sigma: 0.01, columns: 0.01, smooth: 0.02, drift: 0.01}",
    "effects.motion.walk": "{type: random_walk, shift: [0.1, 0.1, 0.1], rotation: [0.1, 0, 0]}",
    "effects.defects": "{dead: 0.01, hot: 0.01, clusters: 1, rows: [3]}",
    "geometry.jitter": "{source: 0.2, panel: 0.3, rotation: 0.1}",
    "source.heel": "true",
    "source.bowtie": "{composition: Al, angles: [0, 3, 6, 9, 12], thickness: [0.5, 1.5, 5, 11, 20]}",
    "detector.resolution": "4.7",
    "detector.fluorescence": "true",
    "detector.charge_sharing": "{type: photon_counting, thresholds: [20, 45, 63.3, 80], resolution: 4.7, "
    "charge_sharing: {pitch: 0.25, cloud: 0.018}}",
    "detector.dead_time": "{tau_ns: 20, exposure_ms: 0.5, model: nonparalyzable}",
    "detector.of_energy": "{type: energy_integrating, composition: CsI}",
    "geometry.helical": "{type: helical, sod: 500, sdd: 800, views: 15, pitch: 40, turns: 2}",
    "geometry.parallel": "{type: parallel, distance: 300, views: 9}",
    "geometry.laminography": "{type: laminography, sod: 500, sdd: 800, tilt: 30, views: 9}",
    "source.multi_source": "{type: multi_source, sources: {low: {type: tube, kvp: 100, photons: 1.0e5}, "
    "high: {type: tube, kvp: 140, photons: 1.0e5}}}",
    "source.lines": "{type: lines, photons: 2.0e5, lines: {40: 1, 60: 2, 90: 1}}",
}


def main() -> None:
    """Record hashes, or compare them with recorded ones; exit code 1 where some differ."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, help="file to write")
    parser.add_argument("--against", type=Path, help="file of recorded hashes")
    parser.add_argument("--only", action="append", help="case to run; repeatable")
    arguments = parser.parse_args()
    cases = {**{name: (name, ()) for name in _presets()}, **{key: ("kedge-small", _setting(key)) for key in EFFECTS}}
    chosen = arguments.only or list(cases)
    begun = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder, arguments.out.open("w") as out:
        for case in tqdm(chosen, disable=None):
            for line in _hashes(case, *cases[case], Path(folder)):
                print(line, file=out, flush=True)
    print(f"{len(chosen)} cases in {time.perf_counter() - begun:.0f} s")
    if arguments.against:
        sys.exit(_compare(arguments.against, arguments.out, set(chosen)))


def _presets() -> list[str]:
    folder = resources.files("phantomgen").joinpath("scene", "presets")
    return sorted(path.name.removesuffix(".yaml") for path in folder.iterdir() if path.name.endswith(".yaml"))


def _setting(key: str) -> tuple[str, ...]:
    """Overrides of one effect; the last part of some keys only names the case."""
    value = EFFECTS[key]
    owner = key.rsplit(".", 1)[0] if "type:" in value and "." in key else key
    return (f"{owner}={value}",)


def _hashes(case: str, preset: str, overrides: tuple[str, ...], folder: Path) -> list[str]:
    text = resources.files("phantomgen").joinpath("scene", "presets", f"{preset}.yaml").read_text()
    panel = yaml.safe_load(text)["panel"]
    width = panel["columns"] * np.ravel(panel["pitch"])[-1]
    scan = folder / f"{case}.h5"
    coarse = [*COARSE, f"panel.rows={PIXELS}", f"panel.columns={PIXELS}", f"panel.pitch={width / PIXELS}"]
    if not any(override.startswith("geometry={") for override in overrides):
        coarse.append("geometry.views=9")
    settings = [word for value in (*coarse, *overrides) for word in ("--set", value)]
    options = ["make", preset, "-o", str(scan), "--voxels", "16", "--threads", "1", "-q", *settings]
    result = CliRunner().invoke(phantomgen, options)
    if result.exit_code:
        return [f"{case} scan refused: {result.stderr.strip()}"]
    lines = [f"{case} {part} {_hash_of(scan, part)}" for part in ("entry", "truth")]
    for method in METHODS:
        run = folder / f"{case}-{method}"
        options = ["fit", str(scan), "-o", str(run), "--method", method, "--threads", "1", "-q", "--no-figures"]
        result = CliRunner().invoke(recon, options)
        word = _hash_of(run / "volumes.h5", "/") if result.exit_code == 0 else f"refused: {result.stderr.strip()}"
        lines.append(f"{case} {method} {word}")
    return [line.replace(str(folder), "FOLDER") for line in lines]


def _hash_of(path: Path, part: str) -> str:
    """Digits of SHA-256 over all arrays of numbers below a group, with their names."""
    digest = hashlib.sha256()

    def add(name: str, item: h5py.Dataset | h5py.Group) -> None:
        if isinstance(item, h5py.Dataset) and item.dtype.kind in "biuf":
            digest.update(name.encode() + np.ascontiguousarray(item[()]).tobytes())

    with h5py.File(path) as file:
        file[part].visititems(add)
    return digest.hexdigest()[:16]


def _compare(before: Path, after: Path, cases: set[str]) -> int:
    old = [line for line in before.read_text().splitlines() if line.split()[0] in cases]
    new = after.read_text().splitlines()
    different = sorted(set(old) ^ set(new))
    print(*different, sep="\n") if different else print(f"{len(new)} lines, all as before")
    return int(bool(different))


if __name__ == "__main__":
    main()
