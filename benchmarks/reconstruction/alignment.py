"""How well `recon align` finds errors of the stated panel: true and estimated values, their errors, and the time.

    python -m benchmarks.reconstruction.alignment [--threads N] [--out FOLDER] [CASE ...]

Scans of presets with small panels. Poses are stated with an error: so many columns, so many rows, so many degrees in
the panel's plane. Of each number: the error that was stated, what is left of it after the alignment, in the axes of the
true panel, and the standard uncertainty that the alignment states; a shift along the rows is not estimated. Then the
difference of an FDK volume of all channels together from that of the true poses, before and after, relative to the
standard deviation of the latter, and the processor time [s] of the alignment.
Rows take the place of those in `results/alignment.txt`.
"""

import argparse
import platform
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import phantomgen
from benchmarks.result_rows import store
from phantomgen.dataset.reader import Dataset
from phantomgen.geometry.panel_changes import moved_panel
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from recon.alignment.align import Alignment, align
from recon.alignment.log_projections import SummedCounts
from recon.voxel.filtered.fdk import fdk
from spectra.errors import GeometryError
from spectra.threads import set_threads, thread_count, without_other_pools

TABLE = Path(__file__).parents[1] / "results" / "alignment.txt"
NAMED = 30  # characters of a row for its case
HEADER = (
    f"{'case':<{NAMED}}{'columns [pixel]':<31}{'rows [pixel]':<22}{'tilt [degree]':<33}{'FDK before, after':<20}CPU s"
)


@dataclass(frozen=True)
class Case:
    """A scan and the error of its stated panel.

    Parameters
    ----------
    preset, changes : the scene
    error : columns [pixel], rows [pixel], turn [degree]
    truncated : part of the columns that is cut off, half on each side
    """

    preset: str
    error: tuple[float, float, float]
    changes: tuple[str, ...] = ()
    truncated: float = 0.0


CASES = {
    "kedge-small": Case("kedge-small", (1.3, 0.0, 0.4)),
    "kedge-small, rows": Case("kedge-small", (-0.6, 2.0, -0.3)),
    "kedge-small, large": Case("kedge-small", (15.0, 0.0, -2.0)),
    "kedge-small, 1 % dose": Case("kedge-small", (1.3, 0.0, 0.4), ("source.photons=2000",)),
    "kedge-small, truncated": Case("kedge-small", (1.3, 0.0, 0.4), truncated=0.5),
    "kedge-small, 220 degrees": Case(
        "kedge-small", (1.3, 0.0, 0.4), ("geometry={type: circular, sod: 500, sdd: 800, views: 60, arc: 220}",)
    ),
    "kedge-small, half-fan": Case(
        "kedge-small", (1.3, 0.0, 0.4), ("panel={rows: 128, columns: 96, pitch: 1.6, offset: {columns: 24}}",)
    ),
    "kedge-small, parallel": Case(
        "kedge-small", (1.3, 0.0, 0.4), ("geometry={type: parallel, views: 60, distance: 300, arc: 180}",)
    ),
    "metal-hip": Case(
        "metal-hip", (-2.3, 0.0, -0.6), ("volume.voxels=64", "panel={rows: 104, columns: 96, pitch: 2.8}")
    ),
    "forbild-head": Case(
        "forbild-head", (4.5, 1.0, 0.6), ("volume.voxels=64", "panel={rows: 130, columns: 124, pitch: 3.2}")
    ),
}


def scanned(case: Case, path: Path) -> Dataset:
    """The scan of a case, with its true poses."""
    if not path.exists():
        phantomgen.make(phantomgen.load(case.preset, list(case.changes)), out=path).close()
    if not case.truncated:
        return phantomgen.open_dataset(path)
    narrow = path.with_name(f"{path.stem}-cut.h5")
    return phantomgen.degrade(path, narrow, truncate=case.truncated, overwrite=True)


def left(true: Geometry, found: Geometry) -> np.ndarray:
    """Shifts [pixel] and turn [degree] of a panel from the true one, in the axes of the true one, mean over views."""
    apart = found.panel_center - true.panel_center
    shifts = [
        np.mean(np.einsum("vi,vi->v", apart, step) / np.einsum("vi,vi->v", step, step))
        for step in (true.column_step, true.row_step)
    ]
    across = np.cross(true.column_step, found.column_step)
    sine = np.einsum("vi,vi->v", across, true.normals())
    cosine = np.einsum("vi,vi->v", true.column_step, found.column_step)
    return np.array([*shifts, np.rad2deg(np.mean(np.arctan2(sine, cosine)))])


def volume(counts: SummedCounts, geometry: Geometry, grid: Grid) -> np.ndarray | None:
    """FDK volume of all channels together; None where the orbit has none."""
    try:
        return fdk(counts.logs_and_weights()[0][:, None], geometry, grid)[0]
    except GeometryError:
        return None


def volume_errors(dataset: Dataset, found: Alignment) -> str:
    """Relative difference of FDK volumes from that of the true poses, before and after."""
    counts = SummedCounts.of(dataset, dataset.splits["train"])
    poses = (dataset.geometry, found.stated, found.geometry)
    true, before, after = (volume(counts, one[dataset.splits["train"]], dataset.grid) for one in poses)
    if true is None or before is None or after is None:
        return "-"
    return "  ".join(f"{np.sqrt(np.mean((v - true) ** 2)) / np.std(true):7.4f}" for v in (before, after))


def row(name: str, case: Case, folder: Path) -> str:
    """One line of the results."""
    with scanned(case, folder / f"{name.replace(' ', '').replace(',', '-').replace('%', '')}.h5") as dataset:
        columns, rows, tilt = case.error
        wrong = dataset._with(geometry=moved_panel(dataset.geometry, columns, tilt, rows))
        began = time.process_time()
        found = align(wrong)
        seconds = time.process_time() - began
        errors = volume_errors(dataset, found)
        remaining = left(dataset.geometry, found.geometry)
    spreads = (f"+- {found.uncertainty[0]:.4f}", "", f"+- {found.uncertainty[1]:.4f}")
    columns, rows, tilt = (
        f"{stated:+7.2f} {rest:+9.4f} {known}"
        for stated, rest, known in zip(case.error, remaining, spreads, strict=True)
    )
    return f"{name:<{NAMED}}{columns:<31}{rows:<22}{tilt:<33}{errors:<20}{seconds:5.0f}"


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
        for name in asked.cases:
            line = row(name, CASES[name], folder)
            store(TABLE, head, line, NAMED)
            print(line, flush=True)


if __name__ == "__main__":
    main()
