"""The picture of `docs/howto/scatter.md`: a scan without scatter, with scatter ignored, and with scatter subtracted.

    python docs/development/draw_scatter.py

Left: the middle slice of the photoelectric volume, by the default fit. Right: its profile through the middle.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import h5py
import numpy as np

import phantomgen
from phantomgen.display.figures.style import WIDTH, figure_file

TARGET = Path(__file__).parents[1] / "images" / "scatter.png"
KERNEL = ["effects.scatter={type: kernel, ratio: 0.3, width: 60}"]
WAYS: dict[str, tuple[list[str], list[str]]] = {  # changes of the scene, and options of `recon fit`
    "no scatter": ([], []),
    "scatter ignored": (KERNEL, []),
    "--scatter kernel:0.3,60": (KERNEL, ["--scatter", "kernel:0.3,60"]),
}
COLOURS = ("black", "#d55e00", "#0072b2")  # of the palette of Okabe & Ito
STYLES = ("-", "-", "--")


def main() -> None:
    """Scan, reconstruct, draw."""
    with tempfile.TemporaryDirectory() as folder:
        slices, voxel = zip(
            *(slice_of(Path(folder) / str(i), *way) for i, way in enumerate(WAYS.values())), strict=True
        )
    with figure_file(TARGET, (WIDTH, 2.3)) as figure:
        *pictures, profile = figure.subplots(1, 4, width_ratios=(1, 1, 1, 1.35))
        for axis, title, image, colour, style in zip(pictures, WAYS, slices, COLOURS, STYLES, strict=True):
            axis.imshow(image[::-1], cmap="gray", vmin=0, vmax=1e3 * 0.01)
            axis.set_title(title, family="monospace" if title.startswith("--") else None, fontsize=7.5)
            axis.set_axis_off()
            place = (np.arange(len(image)) - (len(image) - 1) / 2) * voxel[0]
            profile.plot(place, image[len(image) // 2], style, color=colour, label=title, linewidth=1.1)
        profile.set_xlabel("x [mm]")
        profile.set_ylabel("photoelectric [1/m]")
        profile.legend(fontsize=6, loc="upper center", frameon=False)
        profile.set_ylim(0, 1.45 * max(float(s[len(s) // 2].max()) for s in slices))


def slice_of(path: Path, changes: list[str], options: list[str]) -> tuple[np.ndarray, float]:
    """Middle slice of the photoelectric volume [1/m], and the size of its voxels [mm]."""
    scan, run = path.with_suffix(".h5"), path.with_suffix("")
    with phantomgen.make(phantomgen.load("kedge-small", changes), scan) as dataset:
        voxel = dataset.grid.spacing[0]
    command = [sys.executable, "-m", "recon", "fit", scan, "-q", "--no-figures", "-o", run, *options]
    subprocess.run(command, check=True)
    with h5py.File(run / "volumes.h5") as file:
        volumes = file["basis/data"]
        return 1e3 * np.asarray(volumes[0, volumes.shape[1] // 2]), voxel


if __name__ == "__main__":
    main()
