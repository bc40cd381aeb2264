"""The picture of `docs/howto/bodies.md`: slices of a torso and of a head at 70 keV.

    python docs/development/draw_bodies.py

Grey values are CT numbers, -200 to 300 HU; those of the lungs on the right, -1000 to 300 HU.
"""

from pathlib import Path

import numpy as np
from jaxtyping import Float

import phantomgen
from phantomgen.display.figures.style import WIDTH, figure_file
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.scene.scan import Scan

TARGET = Path(__file__).parents[1] / "images" / "bodies.png"
VOXELS = 256
# Name, keys, edge length [mm], slices as (axis, place [mm], darkest [HU]).
BODIES = {
    "torso": (
        phantomgen.Torso(contrast={"phase": "arterial"}),
        420.0,
        ((0, 20.0, -200), (0, -118.0, -200), (2, 2.0, -200), (1, 22.0, -1000)),
    ),
    "head": (
        phantomgen.Head(crowns="gold"),
        260.0,
        ((0, -13.0, -200), (0, 40.0, -200), (2, 0.5, -200), (1, 13.0, -1000)),
    ),
}


def main() -> None:
    """Voxelize slices, and draw."""
    with figure_file(TARGET, (WIDTH, 3.4)) as figure:
        axes = figure.subplots(len(BODIES), 4)
        for row, (name, (body, size, slices)) in zip(axes, BODIES.items(), strict=True):
            scan = phantomgen.Scene(objects=[body], name=name, volume={"voxels": 64, "size": size}).scan
            for axis, (along, place, darkest) in zip(row, slices, strict=True):
                axis.imshow(ct_numbers(scan, size, along, place), cmap="gray", vmin=darkest, vmax=300)
                axis.set_title(f"{name}, {'zyx'[along]} = {place:g} mm", fontsize=7)
                axis.set_axis_off()


def ct_numbers(scan: Scan, size: float, along: int, place: float) -> Float[np.ndarray, "down across"]:
    """CT numbers of one slice; the patient's head, or front, is above."""
    step = size / VOXELS
    shape, origin = [VOXELS] * 3, [-size / 2 + step / 2] * 3
    shape[along], origin[along] = 1, place
    grid = Grid((shape[0], shape[1], shape[2]), (step, step, step), (origin[0], origin[1], origin[2]))
    mu = np.array([m.attenuation(np.array([70.0]), scan.basis)[0] for m in scan.scene.materials])
    water = 0.01929  # 1/mm at 70 keV, NIST
    found = 1000 * (np.tensordot(mu, scan.scene.fractions(grid), axes=1) / water - 1)
    return found[0] if along == 0 else np.take(found, 0, axis=along)[::-1]


if __name__ == "__main__":
    main()
