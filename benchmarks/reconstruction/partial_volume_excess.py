"""What neighbouring pixels tell of partial volume, against the same views in pixels eight times finer.

    python -m benchmarks.reconstruction.partial_volume_excess

Four views of the tuning scenes without noise; pixels of half a voxel and of a whole one, with the noise of the scan.
The excess of a pixel is the logarithm of its mean intensity over the intensity of its mean line integral
(`recon.data.partial_volume`). Root mean squares in each channel, over pixels with 20 counts and an excess: of the
excess, and of what is left of it after the correction, as part of it.
"""

import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import yaml

import phantomgen
from recon.data.measurements import read_measurements
from recon.data.partial_volume import excess_of_pixels

FOLDER = Path(__file__).parents[1]
TABLE = FOLDER / "results" / "partial_volume_excess.txt"
SCENES = ("development", "development_metal", "development_implant", "development_pin")
SIDE, PIXELS, FINER = 204.8, (192, 96), 8  # mm; of the panel
FEWEST, LEAST = 20, 5e-4  # counts; excess


def fine_views(scene: str) -> tuple[np.ndarray, np.ndarray]:
    """Counts without noise in the finest pixels, and without an object."""
    scan = yaml.safe_load((FOLDER / "scenes" / f"{scene}.yaml").read_text(encoding="utf-8"))
    side = PIXELS[0] * FINER
    scan["panel"] = {"rows": side, "columns": side, "pitch": SIDE / side}
    scan["geometry"] |= {"views": 4, "test_views": 1}
    scan["noise"] = False
    with tempfile.TemporaryDirectory() as folder:
        own = Path(folder) / "scan.yaml"
        own.write_text(yaml.safe_dump(scan), encoding="utf-8")
        with phantomgen.make(phantomgen.load(own), out=Path(folder) / "scan.h5") as dataset:
            found = read_measurements(dataset, dataset.splits["train"])
            return np.asarray(found.counts, float), found.gains * found.open_beam


def rows_of(scene: str) -> Iterator[str]:
    """One line of the results for each size of pixels."""
    fine, air = fine_views(scene)
    rng = np.random.default_rng(0)
    for side in PIXELS:
        relative, beam = (mean_of(a, side) for a in (fine / air, air))
        excess = np.log(relative) - mean_of(np.log(fine / air), side)
        counts = rng.poisson(relative * beam).astype(np.float32)
        found = np.stack([excess_of_pixels(view, beam.astype(np.float32)) for view in counts])
        size, left = [], []
        for c in range(fine.shape[1]):
            some = (counts[:, c] >= FEWEST) & (excess[:, c] > LEAST)
            size.append(np.sqrt(np.mean(excess[:, c][some] ** 2)))
            left.append(np.sqrt(np.mean((excess - found)[:, c][some] ** 2)) / size[-1])
        sizes, parts = "  ".join(f"{s:.4f}" for s in size), "  ".join(f"{x:.2f}" for x in left)
        yield f"{scene:<16}{side:>6}  {sizes:<34}{parts}"


def mean_of(images: np.ndarray, side: int) -> np.ndarray:
    """Of the fine pixels in each of `side` x `side`."""
    factor = images.shape[-1] // side
    return images.reshape(*images.shape[:-2], side, factor, side, factor).mean(axis=(-3, -1))


def main() -> None:
    lines = [f"{'scene':<16}{'pixels':>6}  {'excess by channel':<34}left of it"]
    print(lines[0])
    for scene in SCENES:
        for row in rows_of(scene):
            lines.append(row)
            print(row, flush=True)
    TABLE.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
