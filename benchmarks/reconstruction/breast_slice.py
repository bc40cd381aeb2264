"""Maps of three tissues from a slice whose views alternate between 50 and 80 kV, in the geometry of an AAPM challenge.

    python -m benchmarks.reconstruction.breast_slice [--objects solids,pixels] [--methods nothing,one-step,gaussian]

The preset `dl-spectral-breast` is scanned, without noise, twice: as solids with smooth faces, and as the 512 x 512
pixels of its truth, constant in each pixel as the phantoms of the challenge are. The basis volumes of `recon fit` are
decomposed into volume fractions of adipose tissue, glandular tissue and hydroxyapatite (`recon.readouts.fractions`). A
row states the root mean square error of each map over the image, which the challenge scores, and of all three; PSNR of
the photoelectric and the Compton volume [dB]; seconds of the command. A row of `nothing` states the errors of empty
maps. Rows take the place of those in `results/breast_slice.txt`.
"""

import argparse
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import phantomgen
from benchmarks.result_rows import store
from phantomgen.dataset.layout import FRACTION_SCALE
from phantomgen.dataset.reader import Dataset
from phantomgen.dataset.truth import Truth, read_truth
from recon.readouts.fractions import Decomposition
from recon.readouts.spectrum import detected_spectrum
from recon.runs.read_run import read_run
from spectra.materials.material import Material
from spectra.threads import set_threads, thread_count, without_other_pools

PRESET = "dl-spectral-breast"
TISSUES = {"adipose": "adipose", "gland": "breast", "calcification": "hydroxyapatite"}
OBJECTS, METHODS = ("solids", "pixels"), ("nothing", "one-step", "gaussian")
TABLE = Path(__file__).parents[1] / "results" / "breast_slice.txt"
NAMED = 20  # characters of a row for object and method
HEADER = (
    f"{'object':<10}{'method':<10}{'adipose':>10}{'gland':>10}{'calcified':>11}{'all three':>11}"
    f"{'photoelectric':>15}{'Compton':>9}{'seconds':>9}"
)


def as_pixels(truth: Truth, folder: Path) -> list[str]:
    """What makes the preset a scan of pixels: a map of the volume fractions of its truth."""
    files = []
    for name, part in zip(truth.material_names, truth.fractions, strict=True):
        np.save(folder / f"{name}.npy", (part / np.float64(FRACTION_SCALE)).astype(np.float32))
        files.append(f"{name}: {folder / name}.npy")
    spacing = ", ".join(f"{size:.10g}" for size in reversed(truth.grid.spacing))
    return [f"objects=[{{type: voxels, fractions: {{{', '.join(files)}}}, spacing: [{spacing}]}}]"]


def volumes_of(method: str, dataset: Dataset, threads: int) -> np.ndarray:
    """Basis volumes of a method, from the command `recon fit` [1/mm]."""
    if method == "nothing":
        return np.zeros((len(dataset.spectra.basis), *dataset.grid.shape), np.float32)
    run = dataset.path.parent / method
    command = [sys.executable, "-m", "recon", "fit", str(dataset.path), "--method", method, "-o", str(run)]
    subprocess.run(
        [*command, "--overwrite", "--quiet", "--threads", str(threads)], check=True, stdout=subprocess.DEVNULL
    )
    return read_run(run).volumes


def maps_of(volumes: np.ndarray, dataset: Dataset) -> np.ndarray:
    """Volume fractions of the tissues."""
    spectra = dataset.spectra
    materials = [Material(name, composition=composition) for name, composition in TISSUES.items()]
    spectrum = detected_spectrum(spectra.basis, spectra.transmission())
    return Decomposition.of(materials, spectra.basis, *spectrum).fractions(volumes)


def row_of(shape: str, method: str, dataset: Dataset, truth: Truth) -> str:
    """One line of the results."""
    begin = time.perf_counter()
    volumes = volumes_of(method, dataset, thread_count())
    seconds = time.perf_counter() - begin
    true = truth.fractions[[truth.material_names.index(name) for name in TISSUES]] / np.float64(FRACTION_SCALE)
    squares = ((maps_of(volumes, dataset) - true) ** 2).mean(axis=(1, 2, 3))
    bases = zip(volumes, truth.volumes, strict=True)
    psnr = [10 * np.log10(part.max() ** 2 / np.mean((found - part) ** 2, dtype=np.float64)) for found, part in bases]
    errors = "".join(f"{error:>{width}.5f}" for error, width in zip(np.sqrt(squares), (10, 10, 11), strict=True))
    return (
        f"{shape:<10}{method:<10}{errors}{np.sqrt(squares.mean()):>11.5f}{psnr[0]:>15.1f}{psnr[1]:>9.1f}{seconds:>9.0f}"
    )


@without_other_pools()
def measure(objects: Sequence[str], methods: Sequence[str]) -> None:
    """Measure and store the rows."""
    with tempfile.TemporaryDirectory() as name:
        folder, changes = Path(name), list[str]()
        for shape in OBJECTS:  # pixels are those of the truth of the solids
            scene = phantomgen.load(PRESET, changes)
            with phantomgen.make(scene, out=folder / f"{shape}.h5", overwrite=True) as dataset:
                truth = read_truth(dataset.path)
                assert truth is not None
                changes = as_pixels(truth, folder)
                for method in methods if shape in objects else ():
                    row = row_of(shape, method, dataset, truth)
                    store(TABLE, [f"{platform.machine()}, {thread_count()} threads", HEADER], row, NAMED)
                    print(row, flush=True)


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--objects", default=",".join(OBJECTS))
    parser.add_argument("--methods", default=",".join(METHODS))
    parser.add_argument("--threads", type=int)
    arguments = parser.parse_args()
    set_threads(arguments.threads)
    print(HEADER)
    measure(arguments.objects.split(","), arguments.methods.split(","))


if __name__ == "__main__":
    main()
