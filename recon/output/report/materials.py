"""Bias and noise inside every material, cross-talk, and scatter plots of materials in the plane of two bases."""

from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float, Integer

from phantomgen.display.figures.style import MILLI, PAGE_WIDTH, UNIT, few_ticks, figure_file
from phantomgen.display.html import Part, Table, picture
from phantomgen.display.html.content import csv_of
from recon.output.report.case import LINES, Case, LeftOut, Parts, number
from spectra.basis.basis import pretty

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MARKERS = ("o", "s", "^", "D", "v")  # marker of each run
MOST_POINTS = 6000  # voxels; largest number in a scatter plot, which limits the size of the page
# hues of Okabe and Ito (2008); where there are more materials markers change
COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#999999")
_KEYS = ("true", "mean", "bias", "sd")


def parts(case: Case) -> Parts:
    """Draw means against the truth and errors with their noise, and create tables of cross-talk.

    Parameters
    ----------
    case : runs of the report

    Returns
    -------
    parts of the page

    Raises
    ------
    LeftOut
        When the runs have no scores per material.
    """
    tables = {case.label(run): run.metrics["materials"] for run in case.runs if run.metrics.get("materials")}
    if not tables:
        raise LeftOut("no truth: the runs have no scores per material")
    numbers = _numbers(tables)
    identity, errors = case.path("materials"), case.path("material_errors")
    case.drawn(identity, identity_figure(tables, case.names, identity))
    case.drawn(errors, error_figure(tables, case.names, errors))
    found: list[Part] = [
        picture(
            identity,
            "Mean of every material in each basis against its true coefficient; on the line both are equal. Bars are "
            "the standard deviation over its voxels. Solutions of one agent show its linearity.",
            numbers,
        ),
        picture(
            errors, "Errors of these means: bias, with bars for the standard deviation over the voxels inside.", numbers
        ),
    ]
    found += [_cross_talk(run.name, run.metrics["cross_talk"]) for run in case.runs if run.metrics.get("cross_talk")]
    return tuple(found)


def scatter_parts(case: Case) -> Parts:
    """Draw voxels in the plane of the first two bases, by material.

    Parameters
    ----------
    case : runs of the report

    Returns
    -------
    parts of the page

    Raises
    ------
    LeftOut
        When there is no truth, or one basis only.
    """
    truth = case.needs_truth()
    if len(case.names) < 2:
        raise LeftOut("there is one basis only")
    names, places = case.names[:2], [truth.basis_names.index(name) for name in case.names[:2]]
    found: list[Part] = []
    for i, run in enumerate(case.runs):
        path = case.path("scatter" if i == 0 else f"scatter_{i}")
        values = case.volumes(run)[:2]
        true = truth.coefficients[:, places]
        figure, text = scatter_figure(values, case.labels, truth.material_names, true, names, path)
        case.drawn(path, figure)
        caption = (
            f"{case.who(run)}Voxels in the plane of {pretty(names[0])} and {pretty(names[1])}, coloured by the "
            "material that fills most of each; crosses are the true materials, and points between them voxels at edges."
        )
        found.append(picture(path, caption, text))
    return tuple(found)


def identity_figure(tables: dict[str, dict[str, Any]], names: tuple[str, ...], path: Path | None = None) -> "Figure":
    """Draw mean against true coefficient, in a panel per basis.

    Parameters
    ----------
    tables : scores per material of each run, by the names of the runs
    names : names of the bases
    path : figure to write, with its CSV where it has one; None for no file

    Returns
    -------
    the figure
    """
    across = min(len(names), 3)
    down = -(-len(names) // across)
    with figure_file(path, (PAGE_WIDTH, 1.75 * down + 0.55)) as figure:
        axes = figure.subplots(down, across, squeeze=False)
        for ax in axes.flat[len(names) :]:
            ax.axis("off")
        for ax, name in zip(axes.flat, names, strict=False):
            found = _points(tables, name)
            ends = np.array(
                [0.0, max((point.true for points in found.values() for point in points), default=1.0) * 1.1]
            )
            ax.plot(ends, ends, color="0.6", linewidth=0.8, zorder=0)
            for (label, points), (colour, _), marker in zip(found.items(), LINES, MARKERS, strict=False):
                true, mean, sd = np.array(points).reshape(-1, 3).T
                ax.errorbar(true, mean, sd, fmt=marker, color=colour, markersize=3.5, elinewidth=0.8, label=label)
            ax.set_title(pretty(name))
            ax.xaxis.set_major_locator(few_ticks())
            ax.set_xlabel(f"true [{UNIT}]")
        for ax in axes[:, 0]:
            ax.set_ylabel(f"mean [{UNIT}]")
        if len(tables) > 1:
            figure.legend(*axes.flat[0].get_legend_handles_labels(), loc="outside upper right", ncols=3)
    return figure


def error_figure(tables: dict[str, dict[str, Any]], names: tuple[str, ...], path: Path | None = None) -> "Figure":
    """Draw bias with noise, in a panel per basis with a line per material.

    Parameters
    ----------
    tables : scores per material of each run, by the names of the runs
    names : names of the bases
    path : figure to write, with its CSV where it has one; None for no file

    Returns
    -------
    the figure
    """
    materials = list(dict.fromkeys(material for table in tables.values() for material in table))
    places = np.arange(len(materials))[::-1]
    with figure_file(path, (PAGE_WIDTH, 0.24 * len(materials) * max(1, len(tables) / 2) + 1.1)) as figure:
        axes = figure.subplots(1, len(names), sharey=True, squeeze=False)[0]
        for ax, name in zip(axes, names, strict=True):
            ax.axvline(0, color="0.6", linewidth=0.8, zorder=0)
            for i, (label, table) in enumerate(tables.items()):
                shift = 0.5 * ((i + 0.5) / len(tables) - 0.5)
                scores = [table.get(material, {}).get(name, {}) for material in materials]
                bias, sd = (np.array([_milli(s.get(key)) for s in scores]) for key in ("bias", "sd"))
                colour = LINES[i % len(LINES)][0]
                marker = MARKERS[i % len(MARKERS)]
                ax.errorbar(
                    bias, places - shift, xerr=sd, fmt=marker, color=colour, markersize=3.5, elinewidth=0.8, label=label
                )
            ax.set_title(pretty(name))
            ax.set_xlabel(f"error [{UNIT}]")
            ax.set_yticks(places, materials)
            ax.xaxis.set_major_locator(few_ticks(3))
        if len(tables) > 1:
            figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper right", ncols=3)
    return figure


def scatter_figure(
    values: Float[np.ndarray, "2 z y x"],
    labels: Integer[np.ndarray, "z y x"],
    materials: tuple[str, ...],
    true: Float[np.ndarray, "material 2"],
    names: tuple[str, ...],
    path: Path | None = None,
) -> tuple["Figure", str]:
    """Draw some voxels of every material, and its true coefficients.

    Parameters
    ----------
    values : coefficients of two bases [1/mm]
    labels : 0 for background, i + 1 for material i
    materials : names of the materials
    true : true coefficients of the materials [1/mm]
    names : names of the two bases
    path : figure to write, with its CSV where it has one; None for no file

    Returns
    -------
    the figure, and the voxels that are drawn as CSV
    """
    rng, table = np.random.default_rng(0), []
    with figure_file(path, (PAGE_WIDTH, 3.7)) as figure:
        ax = figure.subplots()
        for i, material in enumerate(materials):
            inside = np.flatnonzero(labels == i + 1)
            some = rng.choice(inside, min(len(inside), MOST_POINTS // len(materials)), replace=False)
            x, y = values.reshape(2, -1)[:, some]
            marker = MARKERS[i // len(COLOURS) % len(MARKERS)]
            ax.plot(
                MILLI * x, MILLI * y, marker, color=COLOURS[i % len(COLOURS)], markersize=2, alpha=0.5,
                markeredgewidth=0, rasterized=True,
            )  # fmt: skip
            ax.plot([], [], marker, color=COLOURS[i % len(COLOURS)], markersize=5, label=material)
            table += [(material, f"{a:.6g}", f"{b:.6g}") for a, b in zip(x, y, strict=True)]
        ax.plot(*(MILLI * true.T), "x", color="black", markersize=8, markeredgewidth=1.4)
        ax.set(xlabel=f"{pretty(names[0])} [{UNIT}]", ylabel=f"{pretty(names[1])} [{UNIT}]")
        figure.legend(*ax.get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return figure, csv_of(("material", f"{names[0]}_per_mm", f"{names[1]}_per_mm"), table)


class _Point(NamedTuple):
    """Coefficient of a material: true value, mean and standard deviation of its voxels [1e-3/mm]."""

    true: float
    mean: float
    deviation: float


def _points(tables: dict[str, dict[str, Any]], name: str) -> dict[str, list[_Point]]:
    """Points of each material that has voxels inside, by the names of the runs."""
    return {
        label: [
            _Point(_milli(s["true"]), _milli(s["mean"]), _milli(s["sd"]))
            for s in (material.get(name) for material in table.values())
            if s is not None and s.get("mean") is not None
        ]
        for label, table in tables.items()
    }


def _milli(value: float | None) -> float:
    """Value in 1e-3/mm; NaN for None."""
    return float("nan") if value is None else MILLI * value


def _numbers(tables: dict[str, dict[str, Any]]) -> str:
    """Everything about materials as CSV [1/mm]."""
    rows = [
        (label, material, scores["voxels"], basis, *(s.get(key) for key in _KEYS))
        for label, table in tables.items()
        for material, scores in table.items()
        for basis, s in scores.items()
        if basis != "voxels"
    ]
    return csv_of(("run", "material", "voxels", "basis", *_KEYS), rows)


def _cross_talk(name: str, matrix: dict[str, dict[str, float]]) -> Table:
    """Table of the cross-talk of a run: mean coefficients per unit of true ones."""
    header = (name, *(f"true {pretty(b)}" for b in matrix))
    rows = tuple((pretty(row), *(number(v, ".4f") for v in cells.values())) for row, cells in matrix.items())
    caption = "Cross-talk: mean coefficients per unit of true ones; ideal is 1 on the diagonal and 0 elsewhere."
    return Table(header, rows, caption, "cross_talk", csv_of(header, [(r, *c.values()) for r, c in matrix.items()]))
