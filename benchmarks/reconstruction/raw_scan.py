"""How well `phantomgen correct` finds defects, tube output and gains of a raw scan, and what a volume gains from it.

    python -m benchmarks.reconstruction.raw_scan [--threads N] [--out FOLDER] [CASE ...]

Scans of `kedge-small` with 180 views, a million photons per pixel and view, and effects that the file does not tell.
Bad pixels: true ones, missed ones, and good ones that are masked, in all four channels together. Tube output of the
views relative to the flats, and gains of the pixels in views over those in flats: their true standard deviation, and
that of what is left after the correction [%]. Then the difference of FDK volumes of the channels from those of a scan
without effects and with 100 times the photons, mean over the channels, relative to the standard deviation of these [%]:
of the raw scan, after the correction, and of a scan without effects with as many photons.
Rows take the place of those in `results/raw_scan.txt`.
"""

import argparse
import platform
import tempfile
import time
from pathlib import Path

import numpy as np

import phantomgen
from benchmarks.result_rows import store
from phantomgen.correction.run import Corrected, correct_file
from phantomgen.dataset.inpainting import inpainted
from phantomgen.dataset.reader import Dataset, open_dataset
from phantomgen.effects import Effects
from phantomgen.effects.random_streams import Stream
from recon.voxel.filtered.fdk import fdk
from spectra.threads import set_threads, thread_count, without_other_pools

TABLE = Path(__file__).parents[1] / "results" / "raw_scan.txt"
COMMON = ["geometry.views=180", "geometry.test_views=0", "source.photons=1e6"]
CASES = {
    "defects": "{defects: {dead: 0.01, hot: 0.003, clusters: 3, columns: [40], masked: false}}",
    "tube output": "{tube_output: {sigma: 0.02, recorded: false}}",
    "gains drift": "{gain: {sigma: 0.05, drift: 0.01}}",
    "gains of columns": "{gain: {columns: 0.01, in_flats: false}}",
    "gains not in flats": "{gain: {sigma: 0.01, in_flats: false}}",
    "all": "{gain: {sigma: 0.05, columns: 0.01, drift: 0.01}, tube_output: {sigma: 0.02, recorded: false}, "
    "defects: {dead: 0.01, hot: 0.003, clusters: 3, columns: [40], masked: false}}",
}
NAMED = 20  # characters of a row for its case
HEADER = (
    f"{'case':<{NAMED}}{'bad: true, missed, false':<27}{'tube output [%]':<19}{'gains [%]':<17}"
    f"{'FDK raw, corrected, clean [%]':<32}CPU s"
)


def volumes(dataset: Dataset) -> np.ndarray:
    """FDK volumes of all channels; pixels that do not measure are interpolated."""
    logs = np.stack([dataset.line_integrals(view) for view in range(len(dataset.exposure))])
    whole = np.zeros_like(logs)
    for channel in range(logs.shape[1]):
        unseen = np.asarray(np.isnan(logs[:, channel]).any(axis=0))
        whole[:, channel] = inpainted(np.nan_to_num(logs[:, channel]), unseen)
    return fdk(whole, dataset.geometry, dataset.grid, "cosine")


def difference(found: np.ndarray, reference: np.ndarray) -> float:
    """Mean over the channels of the relative rms difference [%]."""
    pairs = zip(found, reference, strict=True)
    return 100 * float(np.mean([np.sqrt(np.mean((a - b) ** 2)) / np.std(b) for a, b in pairs]))


def defects(effects: Effects, found: Corrected, seed: int) -> str:
    """Numbers of true bad pixels, missed ones, and good ones that are masked."""
    masks = np.stack(found.masks) > 0
    true = np.zeros(masks.shape, bool)
    if effects.defects is not None:
        true |= effects.defects.mask(seed, *masks.shape[1:]) > 0
    return f"{true.sum():6d} {np.sum(true & ~masks):5d} {np.sum(masks & ~true):5d}"


def tube(effects: Effects, dataset: Dataset, seed: int, flats: int) -> str:
    """Standard deviation of the true tube output, and of what is left [%]."""
    views = len(dataset.exposure)
    if effects.tube_output is None:
        return f"{0:7.3f} {100 * np.std(dataset.exposure[:, 0]):7.4f}"
    true = effects.tube_output.factors(seed, Stream.PROJECTION, views)
    true = true / effects.tube_output.factors(seed, Stream.FLAT, flats).mean()
    return f"{100 * true.std():7.3f} {100 * np.std(dataset.exposure[:, 0] / true):7.4f}"


def gains(effects: Effects, found: Corrected, seed: int) -> str:
    """Standard deviation of the true gains of views over flats, and of what is left, over pixels that measure [%]."""
    good = np.stack(found.masks) == 0
    true, (channels, rows, columns) = np.ones(good.shape), good.shape
    if effects.gain is not None:
        in_flats = effects.gain.maps(seed, channels, rows, columns, Stream.FLAT)
        true = effects.gain.maps(seed, channels, rows, columns) / in_flats
    left = true / np.stack([one.gain for one in found.gains])
    return f"{100 * true[good].std():6.3f} {100 * left[good].std():6.3f}"


def row(name: str, folder: Path, reference: np.ndarray, clean: float) -> str:
    """One line of the results."""
    scan = phantomgen.load("kedge-small", [*COMMON, f"effects={CASES[name]}"])
    raw, corrected = (folder / f"{name.replace(' ', '-')}{end}.h5" for end in ("", "-corrected"))
    with phantomgen.make(scan, out=raw, overwrite=True) as dataset:
        before = difference(volumes(dataset), reference)
    began = time.process_time()
    found = correct_file(raw, corrected, overwrite=True)
    seconds = time.process_time() - began
    with open_dataset(corrected) as dataset:
        after = difference(volumes(dataset), reference)
        output = tube(scan.effects, dataset, scan.seed, scan.flats)
    numbers = f"{before:8.3f} {after:8.3f} {clean:8.3f}"
    bad, gain = defects(scan.effects, found, scan.seed), gains(scan.effects, found, scan.seed)
    return f"{name:<{NAMED}}{bad:<27}{output:<19}{gain:<17}{numbers:<32}{seconds:5.1f}"


@without_other_pools()
def main() -> None:
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("cases", nargs="*", default=list(CASES), metavar="CASE", help=", ".join(CASES))
    parser.add_argument("--threads", type=int, help="default: all")
    parser.add_argument("--out", type=Path, help="folder to keep the scans in")
    asked = parser.parse_args()
    if unknown := set(asked.cases) - set(CASES):
        parser.error(f"no case {', '.join(sorted(unknown))}; there are {', '.join(CASES)}")
    set_threads(asked.threads)
    head = [f"{platform.machine()}, {thread_count()} threads", HEADER]
    print(HEADER)
    with tempfile.TemporaryDirectory() as scratch:
        folder = asked.out or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        bright = phantomgen.load("kedge-small", [*COMMON, "source.photons=1e8"])
        with phantomgen.make(bright, out=folder / "bright.h5", overwrite=True) as dataset:
            reference = volumes(dataset)
        plain = phantomgen.load("kedge-small", COMMON)
        with phantomgen.make(plain, out=folder / "clean.h5", overwrite=True) as dataset:
            clean = difference(volumes(dataset), reference)
        for name in asked.cases:
            line = row(name, folder, reference, clean)
            store(TABLE, head, line, NAMED)
            print(line, flush=True)


if __name__ == "__main__":
    main()
