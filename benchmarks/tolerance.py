"""Error against time: what a tolerance costs, and whether it is met by an independent yardstick.

    python benchmarks/tolerance.py [kedge multi-energy aorta voxels]

For each scene and each tolerance from 1e-1 to 1e-5: the plan, milliseconds per view (all threads, minimum of three
runs, or one run where it is long), and the worst log error of 24 edge pixels against 512 x 512 rays each and ten times
finer energies, and of 2000 rays against these energies alone. The yardstick's own error at silhouettes is some 2e-5.
Scenes with many materials or voxels take long, because the yardstick does: a minute for `kedge`, many for the others.
"""

import os
import platform
import sys
import tempfile
import time
from pathlib import Path

import matplotlib as mpl
import numpy as np

from phantomgen.ops.expose import CROSSED, VOXELS, expose, expose_brute
from phantomgen.planning import Plan, make_plan
from phantomgen.scene import Scan, load_scene
from phantomgen.simulate_check import FINER
from phantomgen.simulate_check import _ray_errors as ray_errors
from phantomgen.simulate_coverage import sampled_lengths
from phantomgen.simulate_spectra import STEP, compressed_transmission
from phantomgen.simulate_views import expected_view
from spectra.threads import run_parallel, thread_count

mpl.use("Agg")
import matplotlib.pyplot as plt

TOLERANCES = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5)
RAYS, PIXELS, LONG = 512, 24, 2.0
RESULTS = Path(__file__).parent / "results"
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


class Yardstick:
    """Edge pixels of one view, their counts by many rays and fine energies, and those energies."""

    def __init__(self, scan: Scan) -> None:
        self.scan, self.view = scan, len(scan.geometry) // 3
        fine, _ = compressed_transmission(scan, sampled_lengths(scan), 1e-7, refine=False, step=STEP / FINER)
        spectrum = fine.columns, fine.weights, fine.starts, scan.scene.background
        frame, panel = scan.geometry.ray_frames()[self.view], scan.geometry.panel
        classes = expose(frame, panel.rows, panel.columns, scan.scene.solids, *spectrum, sub_rays=2).classes
        pixels = np.argwhere(classes >= CROSSED)
        self.pixels = pixels[np.random.default_rng(9).permutation(len(pixels))[:PIXELS]]
        rays = RAYS // 4 if (classes == VOXELS).any() else RAYS  # voxels have no silhouettes, and each ray costs more

        def brute(some: np.ndarray) -> np.ndarray:
            return expose_brute(frame, some, scan.scene.solids, *spectrum, n=rays)

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


def main() -> None:
    names = sys.argv[1:] or ["kedge", "multi-energy", "aorta", "voxels"]
    busy = f", {os.getloadavg()[0]:.1f} processes busy before the start" if hasattr(os, "getloadavg") else ""
    lines = [f"{platform.machine()}, {thread_count()} threads{busy}"]
    lines.append("scene         tolerance  planned  measured  ms/view  plan [s]  nodes  pixels")
    figure, axes = plt.subplots(figsize=(5.2, 3.6), layout="constrained")
    with tempfile.TemporaryDirectory() as folder:
        for name in names:
            scan = voxel_scene(Path(folder)) if name == "voxels" else load_scene(name)
            curve, yardstick = [], Yardstick(scan)
            for tolerance in TOLERANCES:
                began = time.perf_counter()
                plan = make_plan(scan, tolerance)
                planned = time.perf_counter() - began
                error = yardstick.worst_error(plan)
                curve.append((milliseconds(scan, plan), error))
                how = "; ".join(choice.setting for choice in plan.choices[1:])
                missed = " MISSED" if plan.missed else ""
                lines.append(
                    f"{name:<14}{tolerance:9.0e}  {plan.error:.1e}   {error:.1e}  {curve[-1][0]:7.1f}  {planned:8.1f}"
                    f"  {sum(plan.nodes):5d}  {how}{missed}"
                )
                print(lines[-1], flush=True)
            axes.loglog(*np.array(curve).T, "o-", label=name)
            (RESULTS / "tolerance.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
    axes.set(xlabel="time per view [ms]", ylabel="worst error of log projections")
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig(RESULTS / "tolerance.png", dpi=150)


if __name__ == "__main__":
    main()
