"""The picture of `docs/howto/import.md`: a real scan by a Nikon scanner, imported and reconstructed.

    pip install axitom
    python docs/development/draw_import.py

The package axitom (PyPI, MIT licence) brings one radiogram of a notched tensile specimen, a body of revolution, with
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


def call(program: str, *arguments: object) -> None:
    """Run a command of this project."""
    subprocess.run([sys.executable, "-m", program, *map(str, arguments)], check=True)


if __name__ == "__main__":
    main()
