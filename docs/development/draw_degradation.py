"""The picture of `docs/howto/degrade.md`: one scan, made worse in four ways, and what CGLS makes of it.

    python docs/development/draw_degradation.py

Rows: the projection of the first view in the second channel, and the middle slice of the Compton volume.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import h5py
import numpy as np

import phantomgen
from phantomgen.display.figures.style import WIDTH, figure_file

TARGET = Path(__file__).parents[1] / "images" / "degrade.png"
WAYS = {
    "as measured": {},
    "--dose 0.01": {"dose": 0.01},
    "--views 15": {"views": 15},
    "--arc 120": {"arc": (0.0, 120.0)},
    "--truncate 55%": {"truncate": 0.55},
    "--shift 2px": {"shift": 2.0},
}


def main() -> None:
    """Scan, degrade, reconstruct, draw."""
    with tempfile.TemporaryDirectory() as folder:
        scan = Path(folder) / "scan.h5"
        phantomgen.make(phantomgen.load("kedge-small", ["geometry.views=90"]), scan).close()
        pictures = [picture(scan, Path(folder) / f"{i}.h5", way) for i, way in enumerate(WAYS.values())]
    with figure_file(TARGET, (WIDTH, 2.7)) as figure:
        axes = figure.subplots(2, len(WAYS))
        highest = pictures[0][1].max()
        for (above, below), title, (logs, volume) in zip(axes.T, WAYS, pictures, strict=True):
            side = (pictures[0][0].shape[1] - logs.shape[1]) // 2
            above.imshow(
                np.pad(logs, ((0, 0), (side, side)), constant_values=np.nan),
                cmap="gray",
                vmin=0,
                vmax=np.nanmax(pictures[0][0]),
            )
            below.imshow(volume[::-1], cmap="gray", vmin=0, vmax=highest)
            above.set_title(title, family="monospace" if title.startswith("--") else None, fontsize=7.5)
        for axis in axes.ravel():
            axis.set_axis_off()


def picture(scan: Path, path: Path, way: dict) -> tuple[np.ndarray, np.ndarray]:
    """First projection, and the middle slice of the Compton volume."""
    with phantomgen.degrade(scan, path, **way) as dataset:
        logs = dataset.line_integrals(0)[1]
        compton = dataset.spectra.basis.names.index("compton")
    run = path.with_suffix("")
    subprocess.run([sys.executable, "-m", "recon", "fit", path, "--method", "cgls", "-q", "-o", run], check=True)
    with h5py.File(run / "volumes.h5") as file:
        volumes = file["basis/data"]
        return logs, volumes[compton, volumes.shape[1] // 2]


if __name__ == "__main__":
    main()
