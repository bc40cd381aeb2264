"""Parts of the page about the truth: true volumes and materials."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from phantomgen.dataset.layout import FRACTION_SCALE
from phantomgen.dataset.truth import Truth
from phantomgen.display.figures.style import MILLI, PAGE_WIDTH, UNIT, few_ticks, figure_file, write_csv
from phantomgen.display.html import Code, Part, Table, picture
from phantomgen.display.html.content import csv_of
from spectra.basis.basis import pretty

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PLANES = (("axial", "x", "y"), ("coronal", "x", "z"), ("sagittal", "y", "z"))


def truth_parts(truth: Truth, folder: Path) -> list[Part]:
    """Create the parts about slices, materials, and the scene as text.

    Parameters
    ----------
    truth : the truth
    folder : folder for the pictures

    Returns
    -------
    parts of the page
    """
    path = folder / "truth.svg"
    truth_slices(truth, path)
    caption = "Middle slices of the true basis volumes, in 1/mm at 70 keV. The table has the range of each."
    found: list[Part] = [picture(path, caption), _materials(truth)]
    return [*found, Code("Scene", truth.scene)] if truth.scene else found


def truth_slices(truth: Truth, path: Path | None = None) -> "Figure":
    """Draw slices of the true basis volumes: a row per basis, a column per plane, one scale per row; with a CSV.

    Parameters
    ----------
    truth : the truth
    path : figure to write, with its CSV where it has one; None for no file

    Returns
    -------
    the figure
    """
    names, grid = truth.basis_names, truth.grid
    middle = [n // 2 for n in grid.shape]
    size = np.multiply(grid.shape, grid.spacing)
    side = (PAGE_WIDTH - 1.6) / 3
    high = side * max(1.0, size[0] / size[2]) + 0.1
    with figure_file(path, (PAGE_WIDTH, high * len(names) + 0.55)) as figure:
        axes = figure.subplots(len(names), 4, width_ratios=[1, 1, 1, 0.06], squeeze=False)
        for number, (row, name, volume) in enumerate(zip(axes, names, truth.volumes, strict=True)):
            for axis, (ax, (title, across, up)) in enumerate(zip(row, PLANES, strict=False)):
                extent = [
                    f(grid.axis(a)) + s * grid.spacing["zyx".index(a)] / 2 for a in (across, up) for f, s in _ENDS
                ]
                image = MILLI * volume.take(middle[axis], axis=axis)
                top = MILLI * float(volume.max()) or 1.0
                shown = ax.imshow(image, cmap="gray", vmin=0, vmax=top, extent=extent, origin="lower")
                ax.spines[:].set_visible(True)
                ax.set_xticks([])
                ax.set_yticks([])
                if number == 0:
                    ax.set_title(title)
                if number == len(names) - 1:
                    ax.set_xlabel(f"{across}, {extent[1] - extent[0]:.3g} mm")
            row[0].set_ylabel(pretty(name))
            bar = figure.colorbar(shown, cax=row[3])
            bar.set_label(UNIT)
            bar.locator = few_ticks()
    flat = truth.volumes.reshape(len(names), -1)
    write_csv(path, {"basis": np.arange(len(names)), "lowest_per_mm": flat.min(1), "highest_per_mm": flat.max(1)})
    return figure


_ENDS = ((np.min, -1), (np.max, 1))


def _materials(truth: Truth) -> Table:
    """Coefficients, how they were found, and how much there is of each material."""
    volume = truth.fractions.sum(axis=(1, 2, 3), dtype=np.float64) / FRACTION_SCALE * truth.grid.voxel_volume / 1000
    errors = np.zeros(len(volume)) if truth.fit is None else truth.fit.errors
    header = ("material", *(f"{pretty(name)} [1/mm]" for name in truth.basis_names), "volume [ml]", "fit error")
    rows = tuple(
        (name, *(f"{c:.4g}" for c in row), f"{ml:.3g}", f"{100 * error:.2g} %" if error > 0 else "explicit")
        for name, row, ml, error in zip(truth.material_names, truth.coefficients, volume, errors, strict=True)
    )
    numbers = csv_of(
        ("material", *(f"{name}_per_mm" for name in truth.basis_names), "volume_ml", "fit_error"),
        [
            (name, *row.tolist(), ml, error)
            for name, row, ml, error in zip(truth.material_names, truth.coefficients, volume, errors, strict=True)
        ],
    )
    caption = (
        "Materials in the basis, and how much of each the volume holds. Compositions are fitted over the detected "
        "spectrum, with the relative error that is given; the simulator uses their exact attenuation."
    )
    return Table(header, rows, caption, "materials", numbers)
