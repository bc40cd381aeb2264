"""Errors of materials compared with the Cramér-Rao limit, the least that any estimate from the counts can reach."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, Int

from phantomgen.dataset.reader import Dataset
from phantomgen.dataset.truth import Truth
from phantomgen.display.figures.style import MILLI, PAGE_WIDTH, UNIT, figure_file
from phantomgen.display.html import picture
from phantomgen.display.html.content import csv_of
from phantomgen.geometry.curved_panel import module_frames
from phantomgen.ops.project import project
from recon.data.measurements import matching_bin, read_measurements
from recon.data.view_subsets import evenly_spread_views, view_groups
from recon.evaluation.scoring import FULL_FRACTION
from recon.gaussians.fisher import ray_information
from recon.output.report.case import LINES, Case, LeftOut, Parts
from recon.output.report.materials import MARKERS
from spectra.basis.basis import pretty
from spectra.cramer_rao import least_deviations
from spectra.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_VIEWS = 12  # views; largest number whose information is computed, as others have nearly the same; our choice
COARSE = 2.0  # voxels; largest pixel to which views are binned; our choice


def parts(case: Case) -> Parts:
    """Draw the errors of the means of all materials, and their limits.

    Parameters
    ----------
    case : runs of the report

    Returns
    -------
    parts of the page

    Raises
    ------
    LeftOut
        When the dataset, its truth or scores per material are missing, or when the counts do not determine the bases.
    """
    truth, dataset = case.needs_truth(), case.needs_dataset()
    tables = {case.label(run): run.metrics["materials"] for run in case.runs if run.metrics.get("materials")}
    if not tables:
        raise LeftOut("the runs have no scores per material")
    if tuple(dataset.spectra.basis.names) != truth.basis_names:
        raise LeftOut("the dataset states other bases than its truth")
    try:
        limits = material_limits(dataset, truth)
    except InputError as error:
        raise LeftOut(f"the counts do not determine the bases: {error}") from None
    path = case.path("limits")
    case.drawn(path, limit_figure(tables, limits, case.names, path))
    caption = (
        "Error of each material's mean against its Cramér-Rao limit: the least standard deviation that the counts of "
        "the training views allow an unbiased estimate that knows every shape. An error well above its limit is not "
        "noise, but comes from the method or its model."
    )
    return (picture(path, caption, _numbers(tables, limits)),)


def material_limits(dataset: Dataset, truth: Truth) -> dict[str, dict[str, float]]:
    """Compute the least standard deviation of every coefficient of every material if all shapes were known.

    Parameters
    ----------
    dataset : dataset with the counts
    truth : true material fractions and coefficients

    Returns
    -------
    standard deviations by material and basis [1/mm]

    Raises
    ------
    InputError
        When the channels cannot distinguish the bases.

    Notes
    -----
    With A_rk the length of ray r in material k and F_r the Fisher matrix of the ray's line integrals, the information
    on coefficients (k, m) and (l, n) is sum_r A_rk A_rl (F_r)_mn. It is summed over some of the training views and
    scaled to all.
    """
    train = dataset.splits["train"]
    picked = train[_spread(dataset.exposure[train])]
    measured = read_measurements(dataset, picked)
    measured = measured.binned(matching_bin(measured.geometry, COARSE * min(truth.grid.spacing)))
    filled = np.flatnonzero(truth.fractions.any(axis=(1, 2, 3)))
    panel = measured.geometry.panel
    shares = (truth.fractions[filled] / np.float32(FULL_FRACTION)).astype(np.float32)
    coefficients, bases = truth.coefficients[filled], len(truth.basis_names)
    total = np.zeros((len(filled), bases, len(filled), bases))
    for view in range(len(picked)):
        one = measured[[view]]
        lengths = project(shares, truth.grid, module_frames(one.geometry), panel.rows, panel.columns)[:, 0]
        integrals = np.einsum("krc,km->mrc", lengths, coefficients)
        information = ray_information(one, integrals[None], 0.0)[0]
        weighted = np.einsum("krc,rcmn->krcmn", lengths, information, optimize=True)
        total += np.einsum("krcmn,lrc->kmln", weighted, lengths, optimize=True)
    total *= len(train) / len(picked)
    size = len(filled) * bases
    least = least_deviations(total.reshape(size, size)).reshape(len(filled), bases)
    return {
        truth.material_names[k]: dict(zip(truth.basis_names, map(float, row), strict=True))
        for k, row in zip(filled, least, strict=True)
    }


def _spread(exposure: Float[np.ndarray, "view channel"]) -> Int[np.ndarray, " few"]:
    """Indices of some of the views; of every kind where tube voltages are switched."""
    groups = view_groups(exposure)
    if groups.any():
        return evenly_spread_views(groups, MOST_VIEWS)
    return np.unique(np.linspace(0, len(groups) - 1, min(len(groups), MOST_VIEWS)).round().astype(int))


def limit_figure(
    tables: dict[str, dict[str, Any]],
    limits: dict[str, dict[str, float]],
    names: tuple[str, ...],
    path: Path | None = None,
) -> "Figure":
    """Draw limits as ticks and absolute errors of means as points, in a panel per basis with a logarithmic axis.

    Parameters
    ----------
    tables : scores per material of each run, by the names of the runs
    limits : limits by material and basis [1/mm]
    names : names of the bases
    path : figure to write, with its CSV where it has one; None for no file

    Returns
    -------
    the figure
    """
    materials = list(limits)
    places = np.arange(len(materials))[::-1]
    with figure_file(path, (PAGE_WIDTH, 0.26 * len(materials) + 1.35)) as figure:
        axes = figure.subplots(1, len(names), sharey=True, squeeze=False)[0]
        for ax, name in zip(axes, names, strict=True):
            least = np.array([MILLI * limits[material].get(name, np.nan) for material in materials])
            ax.plot(least, places, "|", color="black", markersize=11, markeredgewidth=1.6, label="limit")
            for i, (label, table) in enumerate(tables.items()):
                bias = [table.get(material, {}).get(name, {}).get("bias") for material in materials]
                error = np.array([np.nan if b is None else MILLI * abs(b) for b in bias])
                style = {"color": LINES[i % len(LINES)][0], "markersize": 4}
                ax.plot(error, places, MARKERS[i % len(MARKERS)], label=f"error, {label}", **style)
            ax.set(xscale="log", title=pretty(name), xlabel=UNIT)
            ax.grid(axis="x", color="0.9", linewidth=0.5)
            ax.set_yticks(places, materials)
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return figure


def _numbers(tables: dict[str, dict[str, Any]], limits: dict[str, dict[str, float]]) -> str:
    """Errors and limits as CSV [1/mm]."""
    rows = [
        (label, material, basis, scores[basis]["bias"], limits[material][basis])
        for label, table in tables.items()
        for material, scores in table.items()
        for basis in limits.get(material, {})
        if basis in scores
    ]
    return csv_of(("run", "material", "basis", "error_of_mean_per_mm", "limit_per_mm"), rows)
