"""Expected counts of a voxel map: error of log projections against 64 x 64 rays per pixel, and time per view.

    python -m benchmarks.simulator.voxel_views

A rod (0.06/mm, 24 mm) in a cylinder (0.02/mm, 88 mm), labels in 128^3 voxels of 0.8 mm; 300 pixels of one view are
compared. Time is that of one thread. Prints, and writes to results/voxel_views.txt beside this file.
"""

import os
import platform
import time
from pathlib import Path

import numpy as np

from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry
from phantomgen.ops.expected_counts import Sampling, Spectrum, expected_counts, expected_counts_by_grid
from phantomgen.ops.voxel_maps import VoxelMap
from phantomgen.shapes import Voxels, solids_of

VOXELS, SPACING = 128, 0.8
SPECTRUM = Spectrum(np.array([[0.02], [0.06]]), np.array([1e5]), np.array([0, 1]))


def rod_in_cylinder() -> np.ndarray:
    """Labels 1 and 2."""
    z, y, x = np.indices((VOXELS,) * 3) - (VOXELS - 1) / 2
    cylinder = (np.hypot(x, y) < 55) & (abs(z) < 50)
    return cylinder.astype(int) + ((np.hypot(x - 9, y - 20) < 15) & (abs(z) < 40))


def main() -> None:
    content = VoxelMap.of_labels(rod_in_cylinder(), [1, 2])
    solids = solids_of([(Voxels(content, np.eye(3) * VOXELS * SPACING / 2, np.zeros(3)), (0, 1))])
    busy = f"{os.getloadavg()[0]:.1f} processes busy" if hasattr(os, "getloadavg") else ""
    lines = [
        f"{platform.machine()}, one thread, {busy}",
        "pixels  in voxels  rays per voxel and side  rms      worst    ms per view",
    ]
    rng = np.random.default_rng(1)
    for side in (64, 128, 256):
        panel = Panel(side, side, 204.8 / side)
        frame = Geometry.circular(500.0, 800.0, np.array([0.3]), panel).ray_frames()[0]
        chosen = np.argwhere(np.ones((side, side)))[rng.choice(side**2, 300, replace=False)]
        brute = expected_counts_by_grid(frame, chosen, solids, SPECTRUM, n=64)
        for rays in (1.0, 2.0, 4.0, 8.0):
            expected_counts(frame, side, side, solids, SPECTRUM, sampling=Sampling(rays_per_voxel=rays))
            begin = time.thread_time()
            counts = expected_counts(frame, side, side, solids, SPECTRUM, sampling=Sampling(rays_per_voxel=rays)).counts
            took = 1e3 * (time.thread_time() - begin)
            error = np.log(counts[:, chosen[:, 0], chosen[:, 1]].T / brute)
            ratio = 204.8 / side / 1.6 / SPACING
            lines.append(
                f"{side}^2".ljust(8) + f"{ratio:9.2f}  {rays:23g}  {np.sqrt((error**2).mean()):.1e}"
                f"  {abs(error).max():.1e}  {took:11.0f}"
            )
    text = "\n".join(lines) + "\n"
    print(text)
    (Path(__file__).parents[1] / "results" / "voxel_views.txt").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
