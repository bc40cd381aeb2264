"""What `recon uncertainty` and `recon quality` found by reconstructing a run anew with other noise."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float

from phantomgen.display.figures.style import PAGE_WIDTH, figure_file, write_csv
from phantomgen.display.html import Part, Table, picture
from phantomgen.geometry.voxel_grid import Grid
from recon.detectability.image_quality import stored_qualities
from recon.detectability.quality_figure import draw_quality
from recon.figures.run_figures import borders
from recon.output.report.case import Case, LeftOut, Parts, number
from recon.readouts.quantity import in_pieces
from recon.runs.read_run import open_model, read_run
from recon.uncertainty.estimate import stored_replicates
from recon.uncertainty.spread import Replicates
from recon.uncertainty.summary import main_quantities
from spectra.basis.basis import pretty
from spectra.errors import DatasetError

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Deviation(NamedTuple):
    """Standard deviation of one volume.

    Parameters
    ----------
    title, unit : of the volume
    values : standard deviation of each voxel
    """

    title: str
    unit: str
    values: Float[np.ndarray, "z y x"]


def parts(case: Case) -> Parts:
    """Draw standard deviations of voxels, and list those of means over materials.

    Parameters
    ----------
    case : runs of the report

    Returns
    -------
    parts of the page

    Raises
    ------
    LeftOut
        When no run has replicates.
    """
    found: list[Part] = []
    for i, run in enumerate(case.runs):
        try:
            replicates = stored_replicates(run.folder)
        except DatasetError:
            continue
        path = case.path(f"uncertainty{'' if i == 0 else f'_{i}'}")
        case.drawn(path, draw_deviations(_deviations(run.folder, replicates), replicates.grid, path))
        found.append(
            picture(
                path,
                f"{case.who(run)}Standard deviation that noise causes in a voxel, middle axial slice, from "
                f"{len(replicates)} replicates. Errors that are the same whatever the noise are not in it.",
            )
        )
        if case.truth is not None and case.truth.grid == replicates.grid:
            found.append(_table(case, run.folder, replicates, i))
    if not found:
        raise LeftOut("no replicates: make them by recon uncertainty")
    return tuple(found)


def detectability_parts(case: Case) -> Parts:
    """Draw the quality of the images of inserts, and list d' of the observers.

    Parameters
    ----------
    case : runs of the report

    Returns
    -------
    parts of the page

    Raises
    ------
    LeftOut
        When no run has such a quality.
    """
    found: list[Part] = []
    rows: list[tuple[str, ...]] = []
    for run in case.runs:
        for quality in stored_qualities(run.folder):
            path = case.path(f"quality{f'_{len(rows)}' if rows else ''}")
            case.drawn(path, draw_quality(quality, path))
            found.append(
                picture(
                    path,
                    f"{case.who(run)}{quality.about}, insert at {quality.insert} mm: a reconstruction with it and one "
                    f"without it, mean difference of {quality.pairs} each, noise power spectrum and task transfer "
                    "function of the slices through it, and d' of observers with intervals of 95 % confidence.",
                )
            )
            observers = (quality.without_prewhitening.value, quality.hotelling.value, quality.ideal)
            contrast = f"{number(quality.contrast, '.4g')} {quality.unit}"
            numbers = map(number, (quality.contrast_to_noise, *observers))
            rows.append((case.who(run).rstrip(": "), f"{quality.about}, {quality.insert}", contrast, *numbers))
    if not found:
        raise LeftOut("no insert was looked at: name one by recon quality")
    header = (
        "",
        "image, insert [mm]",
        "contrast",
        "contrast to noise",
        "d' without prewhitening",
        "d' channelised Hotelling",
        "d' ideal",
    )
    caption = "The ideal observer decides from the counts of all training views: no reconstruction exceeds its d'."
    return (*found, Table(header, tuple(rows), caption, "quality"))


def _deviations(folder: Path, replicates: Replicates) -> list[Deviation]:
    """Standard deviations of the bases, of CT numbers and of concentrations."""
    each = zip(replicates.basis_names, replicates.spread().deviation, strict=True)
    bases = [Deviation(pretty(name), "1/mm", values) for name, values in each]
    shown = main_quantities(open_model(folder))
    return bases + [Deviation(q.about, q.unit, replicates.quantity(q).deviation) for q in shown]


def draw_deviations(deviations: Sequence[Deviation], grid: Grid, path: Path | None = None) -> "Figure":
    """Draw the middle axial slice of standard deviations, with the central row as CSV.

    Parameters
    ----------
    deviations : of each volume
    grid : of the volumes
    path : figure to write, with its CSV where it has one; None for no file

    Returns
    -------
    the figure
    """
    middle, columns = grid.shape[0] // 2, 2 if len(deviations) in (2, 4) else 3
    rows = -(-len(deviations) // columns)
    extent = (*borders(grid, "x"), *borders(grid, "y"))
    with figure_file(path, (PAGE_WIDTH, (3.6 if columns == 2 else 2.8) * rows)) as figure:
        axes = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
        for ax, each in zip(axes.flat, deviations, strict=False):
            image = each.values[middle]
            known = image[np.isfinite(image)]
            top = float(np.quantile(known, 0.999)) if known.size else 1.0
            drawn = ax.imshow(image, cmap="viridis", vmin=0, vmax=max(top, 1e-12), extent=extent, origin="lower")
            ax.set_title(each.title)
            bar = figure.colorbar(drawn, ax=ax, location="bottom", extend="max", aspect=18)
            bar.set_label(each.unit)
            bar.ax.tick_params(labelsize="small")
            bar.ax.ticklabel_format(scilimits=(-2, 3))
        for ax in axes.flat[len(deviations) :]:
            ax.set_visible(False)
        for ax in axes[:, 0]:
            ax.set_ylabel("y [mm]")
        for ax in axes[-1]:
            ax.set_xlabel("x [mm]")
    row = grid.shape[1] // 2
    columns_of = {f"{each.title} [{each.unit}]": each.values[middle, row] for each in deviations}
    write_csv(path, {"x_mm": grid.axis("x"), **columns_of})
    return figure


def _table(case: Case, folder: Path, replicates: Replicates, run: int) -> Table:
    """Means of bases and quantities inside of each material, with standard deviations, and the truth."""
    truth = case.needs_truth()
    result, true = read_run(folder).volumes, case.true
    assert true is not None
    shown = main_quantities(open_model(folder))
    order = [case.names.index(name) for name in replicates.basis_names]
    rows = []
    for i, material in enumerate(truth.material_names):
        inside = truth.fractions[i] == np.iinfo(truth.fractions.dtype).max
        if not inside.any():
            continue
        for q in shown:
            deviation = float(replicates.region(inside, lambda v, q=q: in_pieces(q, v)).deviation)
            means = [float(in_pieces(q, values)[inside].mean()) for values in (result, true[order])]
            rows.append((material, f"{q.about} [{q.unit}]", number(means[0], ".2f"), number(deviation, ".2g"),
                         number(means[1], ".2f")))  # fmt: skip
    header = ("material", "quantity", "mean", "standard deviation of the mean", "truth")
    caption = (
        "Means over the voxels that a material fills, the standard deviation that noise causes in such a mean, and the "
        "mean of the truth. A difference of many standard deviations is an error of method or model, not noise."
    )
    return Table(header, tuple(rows), caption, "uncertainty" if run == 0 else f"uncertainty_{run}")
