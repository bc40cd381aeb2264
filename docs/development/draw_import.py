"""The picture of `docs/howto/import.md`: a real scan by a Nikon scanner, imported and reconstructed, and its numbers.

    pip install axitom
    python docs/development/draw_import.py

The package axitom (MIT licence) brings one radiogram of a notched tensile specimen, a body of revolution, with
its .xtekct file, and what other software made of all 3142 views.
"""

import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

import h5py
import numpy as np
import tifffile

from phantomgen.display.figures.style import WIDTH, figure_file

TARGET = Path(__file__).parents[1] / "images" / "import-nikon.png"
# The file says 60000 for the open beam, but the image is divided by it already; the axis is where left and right agree.
STATED = ("--white", "0.985", "--photons", "20000", "--axis-column", "736.5")
COARSE = ("--bin", "5", "--every", "26", "--voxels", "200", "--size", "27.2")
OTHER_VOXEL = 0.0136092  # mm, by settings.xtekct


def main() -> None:
    """Import, reconstruct, draw."""
    spec = find_spec("axitom")
    if spec is None or spec.origin is None:
        raise SystemExit("axitom is not installed: pip install axitom")
    data = Path(spec.origin).parent / "tests" / "example_data"
    with tempfile.TemporaryDirectory() as folder:
        scan, run = Path(folder) / "scan.h5", Path(folder) / "run"
        call("phantomgen", "import", "nikon", data / "radiogram.xtekct", "-o", scan, *STATED, *COARSE)
        call("recon", "fit", scan, "--method", "fdk", "-q", "-o", run)
        with h5py.File(run / "volumes.h5") as file:
            volume = file["basis/data"][0]
            z, x = (file["grid/origin"][i] + file["grid/spacing"][i] * np.arange(volume.shape[i]) for i in (0, 2))
    half = tifffile.imread(data / "recon_by_external_software.tif").astype(float)
    compare(volume, z, half)
    other = np.hstack([half[:, ::-1], half])
    reach = OTHER_VOXEL * half.shape[1]
    with figure_file(TARGET, (WIDTH, 3.0)) as figure:
        axes = figure.subplots(1, 3)
        axes[0].imshow(-np.log(tifffile.imread(data / "radiogram.tif")), cmap="gray")
        middle = volume.shape[1] // 2
        edges = (x[0], x[-1], z[0], z[-1])
        axes[1].imshow(volume[:, middle], cmap="gray", vmin=0, vmax=0.045, extent=edges, origin="lower")
        high = OTHER_VOXEL * other.shape[0] / 2
        axes[2].imshow(
            other, cmap="gray", vmin=0, vmax=0.045 / 1.46e-6, extent=(-reach, reach, -high, high), origin="lower"
        )
        titles = "radiogram, -log", "this program, FDK, one radiogram", "other software, 3142 views"
        for axis, title in zip(axes, titles, strict=True):
            axis.set_title(title, fontsize=8)
        axes[0].set_axis_off()
        for axis in axes[1:]:
            axis.set(xlim=(-reach, reach), ylim=(-13, 13), xlabel="x [mm]")
        axes[1].set_ylabel("z [mm]")


def compare(volume: np.ndarray, z: np.ndarray, half: np.ndarray) -> None:
    """Print how well the sections agree, averaged to our voxels, over heights that they may be shifted by."""
    middle, pixels = volume.shape[1] // 2, half.reshape(len(half), 40, 10).mean(axis=2)
    sides = volume[:, :, middle : middle + 40], volume[:, :, middle - 40 : middle][:, :, ::-1]
    ours = np.mean([side[:, y] for side in sides for y in (middle - 1, middle)], axis=0)[12:-12]
    for shift in (-0.2, -0.1, 0.0, 0.1, 0.2):
        rows = np.rint((z[12:-12] + shift) / OTHER_VOXEL + len(half) // 2).astype(int)
        theirs = np.stack([pixels[row - 5 : row + 5].mean(axis=0) for row in rows])
        scale, offset = np.polyfit(theirs.ravel(), ours.ravel(), 1)
        apart = np.abs(scale * theirs + offset - ours).mean() / np.ptp(np.percentile(ours, [5, 95]))
        alike = np.corrcoef(ours.ravel(), theirs.ravel())[0, 1]
        print(f"shift {shift:+.1f} mm: correlation {alike:.4f}, mean difference {apart:.2%} of the range")


def call(program: str, *arguments: object) -> None:
    """Run a command of this project."""
    subprocess.run([sys.executable, "-m", program, *map(str, arguments)], check=True)


if __name__ == "__main__":
    main()
