"""What a panel that cuts off its object costs inside the field of view: the same scene seen whole and cut off, fitted.

    python -m benchmarks.reconstruction.truncation [--threads N] [--out FOLDER] [SCENE ...]

Scenes of `truncation.yaml`: 45 views, 64 rows of 3.2 mm, 24^3 to 36^3 voxels of 3 mm. Both scans ask for the same grid
and are fitted by the default recipe with all bases. PSNR [dB] of the basis volumes in a cylinder about the axis, 60 mm
high, of a radius 4 mm less than that of the field of view of the narrow panel; both scans are scored in the same one.
Then the loss of each basis [dB]; chi-square of the test views in the worst channel, away from edges, whole and cut off;
keys of the verdict of the cut-off scan that are about coverage; processor time of both fits.

A second row, "round extent", has the scene without `recon.voxel.margin`, where that changes the grid.
Rows take the place of those in `results/truncation.txt`.
"""

import argparse
import platform
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import yaml
from jaxtyping import Bool, Float

import phantomgen
from benchmarks.result_rows import store
from phantomgen.dataset.reader import Dataset
from phantomgen.dataset.truth import Truth, read_truth
from phantomgen.geometry.voxel_grid import Grid
from recon.data.coverage import border_distances, coverage
from recon.data.measurements import read_measurements
from recon.evaluation.metrics import psnr
from recon.evaluation.scoring import score_test_views
from recon.evaluation.verdict import outside_grid, truncated
from recon.gaussians.recipe import FAST
from recon.gaussians.reconstruct import Reconstruction, reconstruct
from spectra.threads import set_threads, thread_count, without_other_pools

SCENES = Path(__file__).parents[1] / "scenes" / "truncation.yaml"
TABLE = Path(__file__).parents[1] / "results" / "truncation.txt"
COMMON = ["geometry.views=45", "geometry.test_views=6"]
ROWS, PITCH = 64, 3.2  # of the panel; mm
RIM, HEIGHT = 4.0, 60.0  # mm; between the cylinder that is scored and the border of the field of view, and its height
NAMED = 34  # characters of a row for its scene
HEADER = (
    f"{'scene':<{NAMED}}{'seen whole':<21}{'cut off':<21}{'loss':<23}{'off edges':>15}{'CPU s':>13}  verdict, cut off"
)


@dataclass(frozen=True)
class Fitted:
    """A fit of a scan.

    Parameters
    ----------
    found : the fit
    away : chi-square of the test views in the worst channel, away from edges
    seconds : processor time of the fit
    """

    found: Reconstruction
    away: float
    seconds: float

    @classmethod
    def of(cls, dataset: Dataset) -> "Fitted":
        began = time.process_time()
        found = reconstruct(dataset, FAST)
        seconds = time.process_time() - began
        channels = score_test_views(dataset, found.gaussians).values()
        return cls(found, max(c["chi_square_away"] for c in channels), seconds)

    @property
    def verdict(self) -> str:
        """Keys of what the verdict says of coverage."""
        covered = self.found.coverage
        assert covered is not None
        return ", ".join(said.key for said in (truncated(covered), outside_grid(covered)) if said) or "-"


def scanned(scene: dict[str, Any], panel: str, path: Path) -> Dataset:
    """The scan of a scene by one of its panels."""
    columns, shift = scene[panel]
    changes = {name: value for name, value in scene.items() if name not in ("sees", "cuts")}
    changes["panel"] = {"rows": ROWS, "columns": columns, "pitch": PITCH, "offset": {"columns": shift}}
    lines = [f"{name}={yaml.safe_dump(value, default_flow_style=True, width=10**6)}" for name, value in changes.items()]
    return phantomgen.make(phantomgen.load("kedge-small", [*COMMON, *lines]), out=path, overwrite=True)


def scored_part(dataset: Dataset) -> Bool[np.ndarray, "z y x"]:
    """Voxels of the cylinder that all views see; of a half-fan, what a view or its opposite sees."""
    radius = border_distances(dataset.geometry).max(axis=1).min() - RIM
    return inside(dataset.grid, radius)


def inside(grid: Grid, radius: float) -> Bool[np.ndarray, "z y x"]:
    """Voxels whose centres lie in a cylinder about the axis."""
    z, y, x = np.meshgrid(*(grid.axis(name) for name in "zyx"), indexing="ij")
    return (np.hypot(x, y) < radius) & (np.abs(z) < HEIGHT / 2)


def scores(fitted: Fitted, truth: Truth, part: Bool[np.ndarray, "z y x"]) -> Float[np.ndarray, " basis"]:
    """PSNR of each basis in a part of the grid [dB]; the peak is that of the truth there."""
    volumes = fitted.found.gaussians.volume(truth.grid)
    pairs = ((v[part].astype(float), t[part].astype(float)) for v, t in zip(volumes, truth.volumes, strict=True))
    return np.array([psnr(t.max(), np.mean((v - t) ** 2)) for v, t in pairs], float)


def rows(name: str, scene: dict[str, Any], folder: Path) -> Iterator[str]:
    """Lines of the results for a scene."""
    with scanned(scene, "sees", folder / f"{name}-whole.h5") as dataset:
        whole, truth = Fitted.of(dataset), read_truth(dataset.path)
    assert truth is not None
    with scanned(scene, "cuts", folder / f"{name}-cut.h5") as dataset:
        part = scored_part(dataset)
        best = scores(whole, truth, part)
        cut = Fitted.of(dataset)
        yield row_of(name, best, scores(cut, truth, part), whole, cut)
        covered = coverage(read_measurements(dataset, dataset.splits["train"]), dataset.grid)
        assert cut.found.coverage is not None
        if covered.grid != cut.found.coverage.grid:
            with patch("recon.gaussians.fitted_grid.with_margin_found", lambda measured, covered: covered):
                cut = Fitted.of(dataset)
            yield row_of(f"{name}, round extent", best, scores(cut, truth, part), whole, cut)


def row_of(name: str, best: np.ndarray, left: np.ndarray, whole: Fitted, cut: Fitted) -> str:
    """One line of the results."""
    before, after = ("  ".join(f"{score:5.2f}" for score in found) for found in (best, left))
    loss = "  ".join(f"{lost:5.2f}" for lost in best - left)
    away, seconds = f"{whole.away:7.2f}{cut.away:8.2f}", f"{whole.seconds:7.0f}{cut.seconds:6.0f}"
    return f"{name:<{NAMED}}{before:<21}{after:<21}{loss:<23}{away}{seconds}  {cut.verdict}"


@without_other_pools()
def main() -> None:
    scenes = yaml.safe_load(SCENES.read_text(encoding="utf-8"))
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("scenes", nargs="*", default=list(scenes), metavar="SCENE", help=", ".join(scenes))
    parser.add_argument("--threads", type=int, help="default: all")
    parser.add_argument("--out", type=Path, help="folder to keep the scans in")
    asked = parser.parse_args()
    if unknown := set(asked.scenes) - set(scenes):
        parser.error(f"no scene {', '.join(sorted(unknown))}; there are {', '.join(scenes)}")
    set_threads(asked.threads)
    head = [f"{platform.machine()}, {thread_count()} threads", HEADER]
    print(HEADER)
    with tempfile.TemporaryDirectory() as scratch:
        folder = asked.out or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        for name in asked.scenes:
            for row in rows(name, scenes[name], folder):
                store(TABLE, head, row, NAMED)
                print(row, flush=True)


if __name__ == "__main__":
    main()
