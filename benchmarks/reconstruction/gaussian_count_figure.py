"""Draws the table of `benchmarks.reconstruction.gaussian_count`: PSNR against Gaussians, stored numbers and time."""

from collections import defaultdict
from pathlib import Path
from typing import NamedTuple

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.axes import Axes

QUANTITIES = ("Gaussians", "stored numbers", "processor time [s]")
STYLES = {"interface": ("C0", "o", "divided by planes"), "gaussian": ("C1", "s", "plain Gaussians")}


class Row(NamedTuple):
    """A row of the table."""

    scene: str
    kernel: str
    wanted: int
    sizes: tuple[float, float, float]  # Gaussians, numbers, seconds
    same: float  # mean PSNR of the bases on the grid of the truth [dB]
    finer: float  # the same on the finer grid


def read(table: Path) -> list[Row]:
    """Read the rows of a table."""
    rows = []
    for line in table.read_text(encoding="utf-8").splitlines()[2:]:
        left, finer = line.split(" / ")
        scene, kernel, wanted, _, *values = left.split()
        count, numbers, seconds = map(float, values[:3])
        means = [sum(map(float, psnr)) / len(psnr) for psnr in (values[3:], finer.split())]
        rows.append(Row(scene, kernel, int(wanted), (count, numbers, seconds), *means))
    return rows


def draw(table: Path) -> Path:
    """Draw a table; each row of the figure is a scene, each column a quantity, and the mean over bases is drawn.

    Parameters
    ----------
    table : text file

    Returns
    -------
    the picture beside it
    """
    scenes: dict[str, list[Row]] = defaultdict(list)
    for row in read(table):
        scenes[row.scene].append(row)
    size = (4.0 * len(QUANTITIES), 2.6 * len(scenes) + 0.8)
    figure, axes = plt.subplots(
        len(scenes), len(QUANTITIES), figsize=size, sharey="row", squeeze=False, layout="constrained"
    )
    for line, (scene, rows) in zip(axes, scenes.items(), strict=True):
        for column, (panel, quantity) in enumerate(zip(line, QUANTITIES, strict=True)):
            _panel(panel, rows, column)
            panel.set_title(scene if column == 0 else "", loc="left", fontweight="bold")
            panel.set_xlabel(quantity)
        line[0].set_ylabel("PSNR [dB]")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=3, frameon=False)
    picture = table.with_suffix(".png")
    figure.savefig(picture, dpi=110)
    return picture


def _panel(panel: Axes, rows: list[Row], column: int) -> None:
    """Draw one panel: solid on the grid of the scan, dashed on the finer one, a point for each seed."""
    for kernel, (colour, mark, name) in STYLES.items():
        points: dict[int, list[Row]] = defaultdict(list)
        for row in rows:
            if row.kernel == kernel:
                points[row.wanted].append(row)
        if not points:
            continue
        mean = sorted(
            tuple(
                sum(values) / len(values)
                for values in zip(*((r.sizes[column], r.same, r.finer) for r in each), strict=True)
            )
            for each in points.values()
        )
        x, same, finer = zip(*mean, strict=True)
        panel.plot(x, same, color=colour, label=f"{name}, grid of the scan")
        panel.plot(x, finer, "--", color=colour, label=f"{name}, finer grid")
        for each in points.values():
            for row in each:
                panel.plot(row.sizes[column], row.same, mark, color=colour, ms=3)
                panel.plot(row.sizes[column], row.finer, mark, color=colour, ms=3, mfc="white")
    voxels = [row for row in rows if row.kernel == "voxels"]
    if voxels:
        panel.axhline(
            sum(r.same for r in voxels) / len(voxels), color="0.4", lw=1, label="one-step voxels, grid of the scan"
        )
        panel.axhline(
            sum(r.finer for r in voxels) / len(voxels), color="0.4", lw=1, ls="--", label="one-step voxels, finer grid"
        )
    panel.set_xscale("log")
    panel.grid(alpha=0.3)
