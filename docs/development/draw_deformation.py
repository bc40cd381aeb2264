"""The picture of deformation in `docs/howto/time.md`: the objects of `examples/bending.yaml` while they bend.

    python docs/development/draw_deformation.py

Coronal slices of the attenuation at 70 keV, 0.9 to 1.3 times that of soft tissue, at three values of the signal.
"""

from pathlib import Path

import numpy as np

import phantomgen
from phantomgen.display.figures.style import WIDTH, figure_file
from phantomgen.geometry.voxel_grid import Grid

ROOT = Path(__file__).parents[2]
TARGET = ROOT / "docs" / "images" / "deformation.png"
PERIOD = 4.0  # s, of the signal of the scene, which is 0 at time 0 and 1 at half the period
SIZE, PIXELS = 180.0, 360  # mm, and pixels along each edge


def main() -> None:
    """Draw the slices."""
    scan, step = phantomgen.load(ROOT / "examples" / "bending.yaml"), SIZE / PIXELS
    first = (step - SIZE) / 2
    grid = Grid((PIXELS, 1, PIXELS), (step, step, step), (first, 0.0, first))
    energy = np.array([70.0])
    attenuation = np.array([material.attenuation(energy)[0] for material in scan.scene.materials])
    tissue = attenuation[[m.name for m in scan.scene.materials].index("tissue")]
    with figure_file(TARGET, (WIDTH, 2.35)) as figure:
        for axis, time in zip(figure.subplots(1, 3), (0.0, 0.35 * PERIOD, PERIOD / 2), strict=True):
            filled = scan.at_time(time).scene.fractions(grid)[:, :, 0]
            assert scan.dynamics is not None
            value = float(scan.dynamics.signals["breath"].values(np.array([time]))[0])
            image = np.tensordot(attenuation, filled, 1)
            axis.imshow(image[::-1], cmap="gray", vmin=0.9 * tissue, vmax=1.3 * tissue)
            axis.set_title(f"signal {value:.2g}", fontsize=8)
            axis.set_axis_off()


if __name__ == "__main__":
    main()
