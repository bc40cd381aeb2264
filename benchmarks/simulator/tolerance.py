"""Error against time: what a tolerance costs, and whether it is met by an independent reference.

    python -m benchmarks.simulator.tolerance [kedge multi-energy=1e-5 aorta=1e-4,1e-5 voxels ...]
    python -m benchmarks.simulator.tolerance --draw

For each scene and each tolerance from 1e-1 to 1e-5: the plan, milliseconds per view (all threads, minimum of three
runs, or one run where it is long), and the worst log error of 24 edge pixels against 512 x 512 rays each and ten times
finer energies, and of 2000 rays against these energies alone. The reference's own error at silhouettes is some 2e-5.
Scenes with many materials or voxels take long, because the reference does: a minute for `kedge`, many for the others.
Rows take the place of those in `results/tolerance.txt` of the same scene and tolerance; the figure is drawn from that
file, by `--draw` alone where nothing is to be measured.
"""

import os
import platform
import sys
import tempfile
import time
from pathlib import Path

import matplotlib as mpl
import numpy as np

from benchmarks.result_rows import store
from phantomgen.ops.expected_counts import CROSSED, VOXELS, Sampling, Spectrum, expected_counts, expected_counts_by_grid
from phantomgen.scene.scan import Scan, load_scene
from phantomgen.simulation.checks.verification import FINER
from phantomgen.simulation.checks.verification import _ray_errors as ray_errors
from phantomgen.simulation.forward_model.energy_grids import STEP, compressed_transmission
from phantomgen.simulation.forward_model.expected_counts import expected_view
from phantomgen.simulation.forward_model.sampled_rays import sampled_lengths
from phantomgen.simulation.planning.make_plan import make_plan
from phantomgen.simulation.planning.plan import Plan
from spectra.threads import run_parallel, thread_count

mpl.use("Agg")
import matplotlib.pyplot as plt

TOLERANCES = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5)
RAYS, PIXELS, LONG = 512, 24, 2.0
RESULTS = Path(__file__).parents[1] / "results"
TABLE = RESULTS / "tolerance.txt"
NAMED = 23  # characters of a row for its scene and tolerance
HEADER = "scene         tolerance  planned  measured  ms/view  plan [s]  nodes  pixels"
VOXELS_SCENE = """
version: 1
name: voxels
source: {type: tube, kvp: 120, photons: 1e5, filters: [{composition: Al, thickness: 3}]}
detector: {type: photon_counting, thresholds: [20, 50, 70]}
geometry: {type: circular, sod: 500, sdd: 800, views: 8}
panel: {rows: 128, columns: 128, pitch: 1.6}
volume: {voxels: 32, size: 128}
materials: {soft: {composition: water}, bone: {composition: "Bone, Cortical (ICRP)"}}
objects: [{type: voxels, file: labels.npy, spacing: 0.5, labels: {0: null, 1: soft, 2: bone}}]
"""


def voxel_scene(folder: Path) -> Scan:
    """A cylinder with a bony rod and a ball, in 256^3 voxels of 0.5 mm."""
    z, y, x = np.meshgrid(*[(np.arange(256) - 127.5) / 2] * 3, indexing="ij", sparse=True)
    labels = ((x**2 + y**2 < 55**2) & (abs(z) < 50)).astype(np.uint8)
    labels[((x - 20) ** 2 + (y + 5) ** 2 < 12**2) & (abs(z) < 45)] = 2
    labels[(x + 18) ** 2 + (y - 12) ** 2 + (z - 6) ** 2 < 15**2] = 2
    np.save(folder / "labels.npy", labels)
    (folder / "voxels.yaml").write_text(VOXELS_SCENE, encoding="utf-8")
    return load_scene(folder / "voxels.yaml")


class Reference:
    """Edge pixels of one view, their counts by many rays and fine energies, and those energies."""

    def __init__(self, scan: Scan) -> None:
        self.scan, self.view = scan, len(scan.geometry) // 3
        fine, _ = compressed_transmission(scan, sampled_lengths(scan), 1e-7, refine=False, step=STEP / FINER)
        spectrum = Spectrum(fine.columns, fine.weights, fine.starts), scan.scene.background
        frame, panel = scan.geometry.ray_frames()[self.view], scan.geometry.panel
        classes = expected_counts(
            frame, panel.rows, panel.columns, scan.scene.solids, *spectrum, Sampling(sub_rays=2)
        ).classes
        pixels = np.argwhere(classes >= CROSSED)
        self.pixels = pixels[np.random.default_rng(9).permutation(len(pixels))[:PIXELS]]
        rays = RAYS // 4 if (classes == VOXELS).any() else RAYS  # voxels have no silhouettes, and each ray costs more

        def brute(some: np.ndarray) -> np.ndarray:
            return expected_counts_by_grid(frame, some, scan.scene.solids, *spectrum, n=rays)

        parts = run_parallel(brute, np.array_split(self.pixels, len(self.pixels)))
        self.exact = np.concatenate(list(parts)) / fine.open_beam

    def worst_error(self, plan: Plan) -> float:
        """Worst log error of the edge pixels and of rays."""
        t = plan.exposure.transmission
        counts = expected_view(plan.scan, t, self.view, plan.settings)
        found = counts[:, self.pixels[:, 0], self.pixels[:, 1]].T / t.open_beam
        ray = ray_errors(plan.scan, t, 2000, np.random.default_rng(9))
        return float(max(abs(np.log(found / self.exact)).max(), abs(ray).max()))


def milliseconds(scan: Scan, plan: Plan) -> float:
    """Per view, with all threads."""
    count = 2 * thread_count()
    views = np.linspace(0, len(scan.geometry) - 1, count).round().astype(int).tolist()

    def task(view: int) -> None:
        expected_view(scan, plan.exposure.transmission, view, plan.settings)

    took = []
    for _ in range(3):
        began = time.perf_counter()
        list(run_parallel(task, views))
        took.append(time.perf_counter() - began)
        if took[-1] > LONG:
            break
    return 1e3 * min(took) / count


def row_of(scan: Scan, reference: Reference, name: str, tolerance: float) -> str:
    """One line of the results."""
    began = time.perf_counter()
    plan = make_plan(scan, tolerance)
    planned = time.perf_counter() - began
    how = "; ".join(choice.setting for choice in plan.choices[1:]) + (" MISSED" if plan.missed else "")
    return (
        f"{name:<14}{tolerance:9.0e}  {plan.error:.1e}   {reference.worst_error(plan):.1e}  "
        f"{milliseconds(scan, plan):7.1f}  {planned:8.1f}  {sum(plan.nodes):5d}  {how}"
    )


def machine() -> str:
    """Where the times come from."""
    busy = f", {os.getloadavg()[0]:.1f} processes busy before the start" if hasattr(os, "getloadavg") else ""
    return f"{platform.machine()}, {thread_count()} threads{busy}"


def draw() -> None:
    """Error against time, a line per scene, from the table."""
    curves: dict[str, list[tuple[float, float]]] = {}
    for line in TABLE.read_text(encoding="utf-8").splitlines():
        cells = line.split()
        if len(cells) > len(HEADER.split()) and cells[1].startswith("1e-"):
            curves.setdefault(cells[0], []).append((float(cells[4]), float(cells[3])))
    figure, axes = plt.subplots(figsize=(5.2, 3.6), layout="constrained")
    for (name, curve), marker in zip(curves.items(), "os^Dv<>", strict=False):
        axes.loglog(*np.array(curve).T, f"{marker}-", label=name)
    axes.set(xlabel="time per view [ms]", ylabel="worst error of log projections")
    axes.grid(alpha=0.3)
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=4, frameon=False)
    figure.savefig(RESULTS / "tolerance.png", dpi=150)


def main() -> None:
    wanted = sys.argv[1:] or ["kedge", "multi-energy", "aorta", "voxels"]
    with tempfile.TemporaryDirectory() as folder:
        for name, _, values in (word.partition("=") for word in wanted if word != "--draw"):
            scan = voxel_scene(Path(folder)) if name == "voxels" else load_scene(name)
            reference = Reference(scan)
            for tolerance in map(float, values.split(",")) if values else TOLERANCES:
                store(TABLE, [machine(), HEADER], row_of(scan, reference, name, tolerance), NAMED)
    draw()


if __name__ == "__main__":
    main()
