"""Figure of a dose map: its middle slices."""

from pathlib import Path

import numpy as np

from phantomgen.display.figures.style import PAGE_WIDTH, check_picture, figure_file
from phantomgen.dose.dose_map import DoseMap

_PLANES = (("axial", 0, "x", "y"), ("coronal", 1, "x", "z"), ("sagittal", 2, "y", "z"))


def write_figure(found: DoseMap, name: str, path: Path | str) -> Path:
    """Draw the slices through the middle of a dose map as PNG, PDF or SVG; with a CSV of ranges beside SVG.

    Parameters
    ----------
    found : dose in voxels
    name : of the scan
    path : the picture

    Returns
    -------
    path of the picture
    """
    path = Path(path)
    check_picture(path)
    dose, grid = 1e3 * found.dose, found.grid
    highest = float(np.percentile(dose[dose > 0], 99.8))
    shown = [slice(max(kept.min() - 1, 0), kept.max() + 2) for kept in np.nonzero(dose > 0)]
    extents = {}
    for name_of_axis, kept, count, step, origin in zip(
        "zyx", shown, grid.shape, grid.spacing, grid.origin, strict=True
    ):
        first, last = kept.start, min(kept.stop, count)
        extents[name_of_axis] = (origin + (first - 0.5) * step, origin + (last - 0.5) * step)
    size = {axis: high - low for axis, (low, high) in extents.items()}
    widths = [size[across] for _, _, across, _ in _PLANES]
    tallest = max(size[up] for _, _, _, up in _PLANES)
    height = min(0.75 * PAGE_WIDTH * tallest / sum(widths) + 1.6, 5.0)
    with figure_file(path, (PAGE_WIDTH, height)) as figure:
        panels = figure.subplots(1, len(_PLANES), width_ratios=widths)
        for axes, (plane, axis, across, up) in zip(panels, _PLANES, strict=True):
            image = np.take(dose, grid.shape[axis] // 2, axis=axis)[*(shown[i] for i in range(3) if i != axis)]
            picture = axes.imshow(
                image, origin="lower", extent=(*extents[across], *extents[up]), cmap="inferno", vmin=0, vmax=highest
            )
            axes.set_title(plane)
            axes.set_xlabel(f"{across} [mm]")
            axes.set_ylabel(f"{up} [mm]")
            axes.locator_params(nbins=3)
        figure.suptitle(f"{name}: dose of the scan", fontsize=10)
        figure.colorbar(picture, ax=list(panels), label="dose [mGy]", location="bottom", shrink=0.5, aspect=40)
    return path
