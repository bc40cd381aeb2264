"""`recon fit` on every kind of orbit: the same phantom, 48^3 voxels of 2.7 mm, pixels of 1.8 mm.

    python -m benchmarks.reconstruction.orbits [--out FOLDER] [WORD ...]

Scans of `kedge-small`, one of `clinical-helix`; rows whose name begins with one of the words, all where there are
none. PSNR [dB] of the basis volumes from voxels (`one-step`, which a fit starts from) and of the default fit;
chi-square of test views in the worst channel, away from edges and of all rays; processor time of the fit. Rows take
the place of those in `results/orbits.txt`.
"""

import argparse
import platform
import tempfile
import time
from pathlib import Path

import phantomgen
from benchmarks.result_rows import store
from phantomgen.dataset.reader import Dataset
from phantomgen.dataset.truth import read_truth
from recon.evaluation.scoring import psnr_of_bases, score_test_views
from recon.gaussians.recipe import FAST
from recon.gaussians.reconstruct import reconstruct
from recon.voxel.model import Voxels
from spectra.threads import thread_count

TABLE = Path(__file__).parents[1] / "results" / "orbits.txt"
NAMED = 46  # characters of a row for its orbit
HEADER = f"{'orbit':<{NAMED}}{'one-step':<21}{'recon fit':<21}off edges     all  CPU s"
COMMON = ["volume.voxels=48"]
SQUARE = "panel={rows: 72, columns: 72, pitch: 2.88}"
ORBITS = {
    "full circle": [SQUARE, "geometry.views=60"],
    "half-fan, panel shifted by 50 mm": [
        "panel={rows: 72, columns: 48, pitch: 2.88, offset: {columns: 50}}",
        "geometry.views=60",
    ],
    "curved panel, radius 800 mm": [
        "panel={rows: 72, columns: 72, pitch: 2.88, curvature: {radius: 800}}",
        "geometry.views=60",
    ],
    "short scan": [SQUARE, "geometry={type: circular, sod: 500, sdd: 800, views: 60, arc: short, test_views: 20}"],
    "limited arc of 120 degrees, 40 views": [
        SQUARE,
        "geometry={type: circular, sod: 500, sdd: 800, views: 40, arc: 120, test_views: 20}",
    ],
    "parallel beam, 180 degrees": [
        "panel={rows: 72, columns: 72, pitch: 1.8}",
        "geometry={type: parallel, distance: 300, views: 60, test_views: 20}",
    ],
    "helix, 2 turns of 40 mm, 80 views": [
        SQUARE,
        "geometry={type: helical, sod: 500, sdd: 800, views: 80, pitch: 40, turns: 2, test_views: 20}",
    ],
    "clinical-helix, 32 x 184 pixels, 64 views": [
        "panel={rows: 32, columns: 184, pitch: [2.1894, 5.1432], offset: {columns: 1.3}, curvature: {radius: 1085.6}}",
        "geometry.views=64",
        "geometry.test_views=4",
    ],
    "laminography, 25 degrees": [
        SQUARE,
        "geometry={type: laminography, sod: 500, sdd: 800, views: 60, tilt: 25, test_views: 20}",
    ],
}
PRESETS = {"clinical-helix, 32 x 184 pixels, 64 views": "clinical-helix"}  # of rows of another preset


def row_of(name: str, dataset: Dataset) -> str:
    """One line of the results."""
    began = time.process_time()
    found = reconstruct(dataset, FAST)
    seconds = time.process_time() - began
    truth = read_truth(dataset.path)
    assert truth is not None
    start = Voxels(found.initial_volumes, dataset.grid, found.gaussians.basis_names)
    before, after = (
        "  ".join(f"{score:5.2f}" for score in psnr_of_bases(truth, model).values())
        for model in (start, found.gaussians)
    )
    channels = score_test_views(dataset, found.gaussians).values()
    away, everywhere = (max(c[f"chi_square_{rays}"] for c in channels) for rays in ("away", "all"))
    return f"{name:<{NAMED}}{before:<21}{after:<21}{away:9.2f}{everywhere:8.2f}{seconds:7.0f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("words", nargs="*", metavar="WORD")
    parser.add_argument("--out", type=Path, help="folder to keep the scans in")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = asked.out or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        for i, (name, changes) in enumerate(ORBITS.items()):
            if asked.words and not name.startswith(tuple(asked.words)):
                continue
            scan = phantomgen.load(PRESETS.get(name, "kedge-small"), [*COMMON, *changes])
            with phantomgen.make(scan, out=folder / f"orbit-{i}.h5", overwrite=True) as dataset:
                row = row_of(name, dataset)
            store(TABLE, [f"{platform.machine()}, {thread_count()} threads", HEADER], row, NAMED)
            print(row, flush=True)


if __name__ == "__main__":
    main()
