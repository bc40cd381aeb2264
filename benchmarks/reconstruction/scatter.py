"""What scatter does to a reconstruction: ignored, known, and fitted.

    python -m benchmarks.reconstruction.scatter [--threads N] [SCENE ...]

Scenes are `kedge-small` without scatter, with single Compton scatter, with the same behind an anti-scatter grid, with
the same times 1.6, 1.3, 1 and 0.7 in the four channels, and with a kernel of 0.3 times the primary signal. Each is
fitted as `recon fit` does without options, with the values of `--scatter` named in the rows.

A row states the ratio of estimated to simulated scatter, mean over all views, channels and pixels; PSNR [dB] and
bias [1/km] of each basis volume; the largest chi-square of a channel of the test views away from edges; and seconds of
the estimate and of the fit. Simulated scatter is the difference to the same scan without scatter, both without noise.
Rows take the place of those in `results/scatter.txt`.
"""

import argparse
import platform
import tempfile
import time
from pathlib import Path

import h5py
import numpy as np
from jaxtyping import Float

import phantomgen
from benchmarks.result_rows import store
from phantomgen.dataset.file import DETECTOR, seal_file
from phantomgen.dataset.reader import Dataset
from phantomgen.dataset.truth import read_truth
from recon.evaluation.scoring import score_test_views, score_truth
from recon.gaussians.recipe import RECIPES
from recon.gaussians.reconstruct import reconstruct
from recon.scatter.chosen_scatter import ChosenScatter, parse_scatter
from spectra.threads import set_threads, thread_count, without_other_pools

TABLE = Path(__file__).parents[1] / "results" / "scatter.txt"
PRESET = "kedge-small"
COMPTON, KERNEL = "effects.scatter={type: compton}", "effects.scatter={type: kernel, ratio: 0.3, width: 60}"
SCENES: dict[str, tuple[list[str], list[str]]] = {  # changes of the preset, and values of --scatter
    "none": ([], ["", "compton:fit"]),
    "compton": ([COMPTON], ["", "compton", "compton:fit", "compton:fit-channels"]),
    "grid": ([COMPTON, "effects.grid={primary: 0.7, scatter: 0.1}"], ["", "compton:0.142857", "compton:fit"]),
    "channels": ([COMPTON], ["", "compton:1.6,1.3,1,0.7", "compton:fit", "compton:fit-channels"]),
    "kernel": ([KERNEL], ["", "kernel:0.3,60", "kernel:fit,60", "compton:fit"]),
}
FACTORS = {"channels": (1.6, 1.3, 1.0, 0.7)}  # of the scatter in each channel, else 1
Images = Float[np.ndarray, "view channel row column"]
NAMED = 32  # characters of a row for its scene and treatment
HEADER = (
    f"{'scatter':<10}{'--scatter':<22}{'estimate':>9}{'PSNR [dB]':>22}{'bias [1/km]':>24}{'chi-square':>12}"
    f"{'s':>6}{'s':>6}"
)


def simulated(changes: list[str], folder: Path) -> tuple[Images, Images]:
    """Counts without scatter, and the scattered signal, from two scans without noise."""
    counts = []
    for name, overrides in (("without", [c for c in changes if "scatter=" not in c]), ("with", changes)):
        scene = phantomgen.load(PRESET, [*overrides, "noise=false"])
        with phantomgen.make(scene, out=folder / f"{name}.h5", overwrite=True) as dataset:
            counts.append(dataset.load().astype(np.float64))
    return counts[0], counts[1] - counts[0]


def scan_of(scene: str, folder: Path) -> tuple[Dataset, float]:
    """A scan with noise, and its mean scattered signal; factors of channels are put into its counts."""
    changes = SCENES[scene][0]
    plain, scattered = simulated(changes, folder)
    path = folder / f"{scene}.h5"
    phantomgen.make(phantomgen.load(PRESET, changes), out=path, overwrite=True).close()
    if scene in FACTORS:
        scattered *= np.reshape(FACTORS[scene], (1, -1, 1, 1))
        with h5py.File(path, "r+") as file:
            found = file[f"{DETECTOR}/data"]
            assert isinstance(found, h5py.Dataset)
            found[...] = np.random.default_rng(0).poisson(plain + scattered).astype(found.dtype)
        seal_file(path)
    return phantomgen.open_dataset(path), float(scattered.mean())


def row_of(scene: str, treatment: str, dataset: Dataset, scattered: float) -> str:
    """One line of the results."""
    began = time.perf_counter()
    corrected = ChosenScatter.of(dataset, parse_scatter(treatment or None)).dataset
    estimated = time.perf_counter()
    result = reconstruct(corrected, RECIPES["fast"])
    ended = time.perf_counter()
    truth = read_truth(dataset.path)
    assert truth is not None
    basis = score_truth(truth, result.gaussians)["basis"]
    views = score_test_views(corrected, result.gaussians)
    ratio = "-"
    if corrected.scatter is not None:
        gain = dataset.flat.mean(axis=(1, 2)) / dataset.spectra.weights.sum(axis=1)
        images = [corrected.scatter.image(view, *dataset.flat.shape[1:]) for view in range(len(corrected.scatter))]
        found = float(np.mean([(image.mean(axis=(1, 2)) * gain).mean() for image in images]))
        ratio = f"{found / scattered:.3f}" if scattered else f"{found:.3g}"
    decibels = " / ".join(f"{scores['psnr']:.2f}" for scores in basis.values())
    bias = " / ".join(f"{1e6 * scores['bias']:.1f}" for scores in basis.values())
    worst = max(scores["chi_square_away"] for scores in views.values())
    seconds = f"{estimated - began:>6.0f}{ended - estimated:>6.0f}"
    return f"{scene:<10}{treatment or 'ignored':<22}{ratio:>9}{decibels:>22}{bias:>24}{worst:>12.2f}{seconds}"


@without_other_pools()
def main() -> None:
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("scenes", nargs="*", default=list(SCENES), metavar="SCENE", help=", ".join(SCENES))
    parser.add_argument("--threads", type=int, help="default: all")
    asked = parser.parse_args()
    if unknown := set(asked.scenes) - set(SCENES):
        parser.error(f"no scene {', '.join(sorted(unknown))}; there are {', '.join(SCENES)}")
    set_threads(asked.threads)
    print(HEADER)
    with tempfile.TemporaryDirectory() as folder:
        for scene in asked.scenes:
            opened, scattered = scan_of(scene, Path(folder))
            with opened as dataset:
                for treatment in SCENES[scene][1]:
                    row = row_of(scene, treatment, dataset, scattered)
                    store(TABLE, [f"{platform.machine()}, {thread_count()} threads", HEADER], row, NAMED)
                    print(row, flush=True)


if __name__ == "__main__":
    main()
