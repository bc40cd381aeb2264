"""Detectability of a faint sphere, by `recon quality --truth`: methods beside the ideal observer of the counts.

    python -m benchmarks.reconstruction.detectability [--pairs N] [--threads N] [METHOD ...]

`kedge-small` with 48^3 voxels and a tenth of the photons: a cylinder of soft tissue with a sphere of 4 mm radius that
holds a twentieth of the contrast agent of the preset. Contrast and noise are those of CT numbers at 70 keV. Rows take
the place of those in `results/detectability.txt`.
"""

import argparse
import tempfile
import time
from pathlib import Path

import phantomgen
from benchmarks.result_rows import store
from phantomgen.dataset.truth import read_truth
from recon.detectability.classes import reconstruct_classes
from recon.detectability.image_quality import ImageQuality, measure
from recon.detectability.insert import Insert
from recon.gaussians.recipe import FAST
from recon.readouts.quantity import quantity
from recon.readouts.readouts import Readouts
from recon.readouts.spectrum import detected_spectrum
from recon.runs.interfaces import Unwatched
from recon.runs.methods import method_named
from recon.runs.run import run
from recon.runs.run_gaussians import GaussianRun
from recon.runs.run_voxels import VoxelRun
from recon.runs.write_run import RunFolder
from recon.uncertainty.estimate import RepeatableRun
from spectra.threads import set_threads, without_other_pools

TABLE = Path(__file__).parents[1] / "results" / "detectability.txt"
NAMED = 12  # characters of a row for its method
HEADER = (
    f"{'method':<12}{'contrast [HU]':>14}{'noise [HU]':>12}{'CNR':>7}   {'NPW':<20}{'CHO':<20}{'ideal':>6}{'CPU s':>7}"
)
SPHERE = Insert((14.0, 0.0, 0.0), 4.0)
SCENE = [
    "volume.voxels=48",
    "panel={rows: 72, columns: 72, pitch: 2.88}",
    "source.photons=65000",  # a tenth for pixels of this size
    "materials.faint={coefficients: {photoelectric: 0.0017, compton: 0.0188, kedge_63.3: 0.00125}}",
    "objects=[{type: cylinder, material: soft_tissue, radius: 50, length: 100}, "
    "{type: sphere, material: faint, center: [14, 0, 0], radius: 4}]",
]
METHODS = ("fdk", "sirt", "pdhg-tv", "one-step", "gaussian")


@without_other_pools()
def measured(dataset: phantomgen.Dataset, folder: Path, name: str, pairs: int) -> tuple[ImageQuality, float]:
    """Quality of the sphere in CT numbers, and processor time of one reconstruction [s]."""
    method = GaussianRun(FAST, 3) if name == "gaussian" else VoxelRun(method_named(name))
    began = time.process_time()
    with RunFolder(folder / name, overwrite=False) as part:
        run(dataset, part, method, False, Unwatched())
    seconds = time.process_time() - began
    again = RepeatableRun.of_run(folder / name, dataset)
    stored = again.stored
    shown = quantity(Readouts.of(stored.basis, *detected_spectrum(stored.basis, stored.transmission)), "hu")
    classes = reconstruct_classes(again, SPHERE, pairs, 0, Unwatched(), truth=read_truth(dataset.path))
    return measure(classes, shown), seconds


def row_of(name: str, found: ImageQuality, seconds: float) -> str:
    """One line of the results."""
    observers = "".join(
        f"{f'{one.value:.2f} ({one.low:.2f}-{one.high:.2f})':<20}"
        for one in (found.without_prewhitening, found.hotelling)
    )
    return (
        f"{name:<12}{found.contrast:>14.1f}{found.noise:>12.1f}{found.contrast_to_noise:>7.2f}   "
        f"{observers}{found.ideal:>6.2f}{seconds:>7.0f}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("methods", nargs="*", default=METHODS, metavar="METHOD")
    parser.add_argument("--pairs", type=int, default=12, help="reconstructions of each class")
    parser.add_argument("--threads", type=int, help="default: all")
    asked = parser.parse_args()
    set_threads(asked.threads)
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        with phantomgen.make(phantomgen.load("kedge-small", SCENE), out=folder / "scan.h5") as dataset:
            for name in asked.methods:
                row = row_of(name, *measured(dataset, folder, name, asked.pairs))
                store(TABLE, [HEADER], row, NAMED)
                print(row, flush=True)


if __name__ == "__main__":
    main()
