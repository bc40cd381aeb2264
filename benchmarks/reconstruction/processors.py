"""The default fit as processors with other instructions make it, and with other numbers of threads.

    python -m benchmarks.reconstruction.processors [--preset kedge-small] [--limit 0.1] [OPTION ...]

The order in which sums are rounded depends on the instructions that numba and torch use. Both can be told to use
fewer than the processor has: rows are the fit under each of these settings, from the same counts. PSNR [dB] of each
basis volume, its largest difference between rows, and the first digits of the hash of the model; rows of one, two and
four threads must have the same hash. Options are those of `phantomgen make`; without any, the scan is the small one of
the tests. Exit code 3 when a basis differs by more than the limit, or threads change a bit. The table goes to
`results/processors.txt`.
"""

import argparse
import hashlib
import json
import os
import platform
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

TABLE = Path(__file__).parents[1] / "results" / "processors.txt"
SETTINGS = {
    "as it is": {},
    "numba x86-64": {"NUMBA_CPU_NAME": "x86-64"},
    "numba x86-64-v3": {"NUMBA_CPU_NAME": "x86-64-v3"},
    "numba skylake-avx512": {"NUMBA_CPU_NAME": "skylake-avx512"},
    "torch default": {"ATEN_CPU_CAPABILITY": "default"},
    "torch avx2": {"ATEN_CPU_CAPABILITY": "avx2"},
}
THREADS = (1, 2, 4)
SMALL = [
    "--voxels", "16", "--views", "9", "--test-views", "2",
    "--set", "panel={rows: 32, columns: 32, pitch: 6.4}",
]  # fmt: skip


def made(preset: str, options: list[str], folder: Path) -> Path:
    """The scan."""
    target = folder / "scan.h5"
    _run(["phantomgen", "make", "--preset", preset, "-q", "-o", str(target), *options], {})
    return target


def fitted(scan: Path, folder: Path, threads: int, setting: dict[str, str]) -> tuple[dict[str, float], str]:
    """PSNR of each basis [dB], and the hash of the model."""
    run = folder / f"run-{len(list(folder.iterdir()))}"
    _run(["recon", "fit", str(scan), "-o", str(run), "-q", "--no-figures", "--threads", str(threads)], setting)
    scores = json.loads((run / "metrics.json").read_text(encoding="utf-8"))["basis"]
    digest = hashlib.sha256((run / "model.safetensors").read_bytes()).hexdigest()
    return {name: values["psnr"] for name, values in scores.items()}, digest[:12]


def _run(words: list[str], setting: dict[str, str]) -> None:
    command = [sys.executable, "-m", *words]
    subprocess.run(command, check=True, env=os.environ | setting, stdout=subprocess.DEVNULL)


def supported(name: str) -> bool:
    """Whether this processor can run what a setting asks for."""
    if platform.machine() not in ("x86_64", "AMD64"):
        return name == "as it is"
    if "avx512" not in name:
        return True
    cpus = Path("/proc/cpuinfo")
    return cpus.exists() and "avx512vl" in cpus.read_text(encoding="utf-8")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--preset", default="kedge-small")
    parser.add_argument("--limit", type=float, default=0.1, help="largest difference of a basis between rows [dB]")
    parser.add_argument("--out", type=Path, default=TABLE)
    chosen, options = parser.parse_known_args()
    title = f"{chosen.preset} {' '.join(options or SMALL)}"
    with tempfile.TemporaryDirectory() as folder:
        scan = made(chosen.preset, options or SMALL, Path(folder))
        rows, table, hashes = [f"{title}  ({platform.processor() or platform.machine()})"], [], set()
        for name, setting in SETTINGS.items():
            if supported(name):
                psnr, digest = fitted(scan, Path(folder), 1, setting)
                table.append(list(psnr.values()))
                rows.append(f"{name:<24}{' '.join(f'{value:7.2f}' for value in psnr.values())}  {digest}")
                print(rows[-1], flush=True)
        for threads in THREADS:
            psnr, digest = fitted(scan, Path(folder), threads, {})
            hashes.add(digest)
            words = f"{threads} thread{'s' if threads > 1 else ''}"
            rows.append(f"{words:<24}{' '.join(f'{value:7.2f}' for value in psnr.values())}  {digest}")
            print(rows[-1], flush=True)
    spread = np.ptp(table, axis=0)
    rows.insert(len(table) + 1, f"{'largest difference':<24}{' '.join(f'{value:7.3f}' for value in spread)}")
    print(rows[len(table) + 1])
    _store(chosen.out, rows)
    if spread.max() > chosen.limit or len(hashes) > 1:
        sys.exit(3)


def _store(table: Path, rows: list[str]) -> None:
    """Put a block of rows in the place of the one with the same title, or at the end."""
    blocks = table.read_text(encoding="utf-8").split("\n\n") if table.exists() else []
    scan = rows[0].split("  (")[0]
    kept = [block.strip("\n") for block in blocks if block.strip() and block.split("  (")[0].strip() != scan]
    table.write_text("\n\n".join([*kept, "\n".join(rows)]) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
