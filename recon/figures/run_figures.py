"""Figures of a run, each with its numbers as CSV beside it where it has curves.

Every function takes arrays and returns a figure of matplotlib, which it writes where a path is given; matplotlib is
imported when the first one is drawn.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float, Real
from scipy import ndimage

from phantomgen.display.figures.dataset_energies import spectrum
from phantomgen.display.figures.style import (
    BASIS_LINES,
    BLUE,
    GRAY,
    MILLI,
    RESULT,
    TRUTH,
    UNIT,
    WIDTH,
    decades_or_zero,
    few_ticks,
    figure_file,
    write_csv,
)
from phantomgen.geometry.voxel_grid import Grid
from spectra.basis.basis import pretty

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["basis_slices", "borders", "convergence", "profile_line", "profiles", "residuals", "spectrum"]

# axis of the slice, and axes across and up in the figure
_PLANES = {"axial": (0, "x", "y"), "coronal": (1, "x", "z"), "sagittal": (2, "y", "z")}


def basis_slices(
    volumes: Real[np.ndarray, "basis z y x"],
    truth: Real[np.ndarray, "basis z y x"] | None,
    names: Sequence[str],
    grid: Grid,
    path: Path | None = None,
    plane: str = "axial",
    width: float = WIDTH,
    left_out: Sequence[str] = (),
    unit: str = UNIT,
) -> "Figure":
    """Draw the middle slice of every basis: truth, result and their difference, or the result alone.

    Parameters
    ----------
    volumes, truth : coefficients [1/mm]; the truth is NaN for a basis that it lacks, and None where there is none
    names : names of the bases
    grid : grid of the volumes
    path : figure to write, with its CSV where it has one; None for no file
    plane : ``axial`` (x, y), ``coronal`` (x, z) or ``sagittal`` (y, z)
    width : width of the figure where there is a truth [inch]
    left_out : bases that were not fitted, which the title names
    unit : thousandth of the unit of the volumes

    Returns
    -------
    the figure
    """
    axis, across, up = _PLANES[plane]
    middle = grid.shape[axis] // 2
    place = f"{'zyx'[axis]} = {grid.axis('zyx'[axis])[middle]:.3g} mm"
    extent = [*borders(grid, across), *borders(grid, up)]
    result = volumes.take(middle, axis=axis + 1)
    true = None if truth is None else truth.take(middle, axis=axis + 1)
    titles = ["result"] if true is None else ["truth", "result", "result − truth"]
    ratios = [1, 0.06] if true is None else [1, 1, 0.06, 1, 0.06]
    side = 1.85 if true is None else (width - 2.2) / 3
    high = side * (extent[3] - extent[2]) / (extent[1] - extent[0])
    with figure_file(path, (width if true is not None else 3.2, (high + 0.14) * len(names) + 0.75)) as figure:
        axes = figure.subplots(len(names), len(ratios), width_ratios=ratios, squeeze=False)
        pictures = axes[:, [0]] if true is None else axes[:, [0, 1, 3]]
        for row, name in enumerate(names):
            _draw_row(figure, axes[row], result[row], None if true is None else true[row], extent, unit)
            pictures[row, 0].set_ylabel(f"{pretty(name)}\n{up} [mm]")
        for ax in pictures.flat:
            ax.spines[:].set_visible(True)
            ax.tick_params(labelbottom=ax in pictures[-1], labelleft=ax in pictures[:, 0])
        for top, bottom, title in zip(pictures[0], pictures[-1], titles, strict=True):
            top.set_title(title)
            bottom.set_xlabel(f"{across} [mm]")
        missing = ", ".join(map(pretty, left_out))
        figure.suptitle(f"{plane} slice, {place}" + (f"\nnot fitted: {missing}" if missing else ""), fontsize=9.0)
    return figure


def _draw_row(
    figure: "Figure", axes: Any, result: np.ndarray, true: np.ndarray | None, extent: list[float], unit: str
) -> None:
    """Draw one basis: images with one grey scale, and the difference with another scale."""
    known = true is not None and bool(np.isfinite(true).all())
    pictures = [result] if true is None else [true, result]
    top = float(true.max() if known else np.quantile(result, 0.999)) or float(np.abs(result).max()) or 1.0  # type: ignore[union-attr]
    options = {"extent": extent, "origin": "lower"}
    for ax, picture in zip(axes, pictures, strict=False):
        gray = ax.imshow(MILLI * picture, cmap="gray", vmin=0, vmax=MILLI * top, **options)
    ends = "max" if result.min() >= 0 else "both"
    bars = [figure.colorbar(gray, cax=axes[len(pictures)], extend=ends)]
    if true is not None and not known:
        axes[0].text(0.5, 0.5, "not in the truth", transform=axes[0].transAxes, ha="center", va="center", fontsize=8)
        axes[4].set_axis_off()
    elif true is not None:
        limit = float(np.quantile(np.abs(result - true), 0.995)) or 1e-3 * top
        error = axes[3].imshow(
            MILLI * (result - true), cmap="RdBu_r", vmin=-MILLI * limit, vmax=MILLI * limit, **options
        )
        bars.append(figure.colorbar(error, cax=axes[4], extend="both"))
    for bar in bars:
        bar.set_label(unit)
        bar.outline.set_linewidth(0.6)
        bar.locator = few_ticks()


def profiles(
    results: Mapping[str, Real[np.ndarray, "basis z y x"]],
    truth: Real[np.ndarray, "basis z y x"] | None,
    names: Sequence[str],
    grid: Grid,
    path: Path | None = None,
    line: Float[np.ndarray, "2 3"] | None = None,
    width: float = WIDTH,
    unit: str = UNIT,
) -> "Figure":
    """Draw every basis along one line, with a CSV.

    Parameters
    ----------
    results : coefficients of each result [1/mm], by the names of the results
    truth : true coefficients [1/mm]; None where there is none
    names : names of the bases
    grid : grid of the volumes
    path : figure to write, with its CSV where it has one; None for no file
    line : two points (x, y, z) [mm] that the line joins; None for `profile_line` of the last basis of the first result
    width : width of the figure [inch]
    unit : thousandth of the unit of the volumes

    Returns
    -------
    the figure
    """
    first = next(iter(results.values()))
    line = profile_line(first[-1], grid) if line is None else np.asarray(line, dtype=np.float64)
    length = float(np.linalg.norm(line[1] - line[0]))
    position = np.arange(0.0, length, min(grid.spacing) / 2)
    points = line[0] + position[:, None] / length * (line[1] - line[0])
    index = ((points[:, ::-1] - grid.origin) / grid.spacing).T
    columns = {"position_mm": position} | {f"{c}_mm": points[:, i] for i, c in enumerate("xyz")}
    for who, result in results.items():
        rows = [ndimage.map_coordinates(v, index, order=1, mode="nearest") for v in result]
        columns |= {f"{name}_{who}": row for name, row in zip(names, rows, strict=True)}
    if truth is not None:
        true = [ndimage.map_coordinates(v, index, order=0, mode="nearest") for v in truth]
        columns |= {f"{name}_truth": row for name, row in zip(names, true, strict=True)}
    write_csv(path, columns)
    ends = " to ".join("({:.0f}, {:.0f}, {:.0f})".format(*point) for point in line)
    with figure_file(path, (width, 1.45 * len(names) + 0.7)) as figure:
        axes = figure.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0]
        for ax, name in zip(axes, names, strict=True):
            for who, (colour, dashes) in zip(results, ((RESULT, "-"), *BASIS_LINES), strict=False):
                row = MILLI * columns[f"{name}_{who}"]
                ax.plot(position, row, color=colour, linestyle=dashes, label=who)
            if truth is not None:
                true = MILLI * columns[f"{name}_truth"]
                ax.step(position, true, where="mid", color=TRUTH, linewidth=0.7, label="truth")
            ax.text(0.01, 0.97, pretty(name), transform=ax.transAxes, va="top", fontsize=9)
            ax.set_ylabel(unit)
            ax.margins(x=0)
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper right", ncols=3)
        axes[0].set_title(f"from (x, y, z) = {ends} mm", loc="left")
        axes[-1].set_xlabel("position along the line [mm]")
        figure.align_ylabels()
    return figure


def profile_line(volume: Real[np.ndarray, "z y x"], grid: Grid) -> Float[np.ndarray, "2 3"]:
    """Choose a line in an axial slice through the two strongest regions of a volume, or along x through the only one.

    Parameters
    ----------
    volume : coefficients of one basis [1/mm]
    grid : grid of the volume

    Returns
    -------
    points where the line enters and leaves the grid, (x, y, z) [mm]. The slice is the middle one, or that of the
    largest value where the middle one is nearly empty
    """
    smooth = ndimage.uniform_filter(np.asarray(volume, dtype=np.float64), 5)
    middle = grid.shape[0] // 2
    if smooth[middle].max() < 0.3 * smooth.max():
        middle = int(np.unravel_index(smooth.argmax(), smooth.shape)[0])
    labels = np.asarray(ndimage.label(smooth[middle] > 0.3 * smooth[middle].max())[0])  # type: ignore[index]
    regions = np.arange(1, labels.max() + 1)
    order = np.argsort(-np.asarray(ndimage.sum_labels(smooth[middle], labels, regions)))
    centres = [ndimage.center_of_mass(labels == region) for region in regions[order[:2]]] or [(grid.shape[1] // 2, 0.0)]
    points = np.array(centres)[:, ::-1] * grid.spacing[:0:-1] + grid.origin[:0:-1]
    direction = points[1] - points[0] if len(points) == 2 else np.zeros(2)
    if np.linalg.norm(direction) < min(grid.spacing):
        direction = np.array([1.0, 0.0])
    low, high = np.array([borders(grid, c) for c in "xy"]).T
    with np.errstate(divide="ignore", invalid="ignore"):
        steps = np.sort([(low - points[0]) / direction, (high - points[0]) / direction], axis=0)
    ends = points[0] + np.array([[np.nanmax(steps[0])], [np.nanmin(steps[1])]]) * direction
    ends = ends if ends[0, 0] <= ends[1, 0] else ends[::-1]
    return np.column_stack([ends, np.full(2, grid.axis("z")[middle])])


def residuals(
    counts: Real[np.ndarray, "channel row column"],
    expected: Real[np.ndarray, "channel row column"],
    channel_names: Sequence[str],
    path: Path | None = None,
    away: Bool[np.ndarray, "row column"] | None = None,
    width: float = WIDTH,
) -> "Figure":
    """Draw (y - Y) / sqrt(Y) of one test view per channel, and its histograms beside the unit normal, with a CSV.

    Parameters
    ----------
    counts, expected : measured counts y and expected counts Y of one view
    channel_names : names of the channels
    path : figure to write, with its CSV where it has one; None for no file
    away : True for rays away from edges, drawn as a second histogram; None for one histogram
    width : width of the figure where there are several channels [inch]

    Returns
    -------
    the figure

    Notes
    -----
    Above each histogram is the part of the rays that are beyond its range, in the order of the legend.
    """
    sigmas = (counts - expected) / np.sqrt(np.maximum(expected, 1e-9))
    edges = np.linspace(-6, 6, 61)
    centres = (edges[1:] + edges[:-1]) / 2
    normal = np.exp(-(centres**2) / 2) / np.sqrt(2 * np.pi)
    groups = {"all rays": np.ones(counts.shape[1:], bool)} | ({} if away is None else {"away from edges": away})
    columns = {"sigma": centres, "unit_normal": normal}
    side = min((width - 1.6) / len(counts), 3.0)
    with figure_file(
        path, (width if len(counts) > 1 else 4.4, side * counts.shape[1] / counts.shape[2] + 3.0)
    ) as figure:
        axes = figure.subplots(
            2, len(counts), squeeze=False, sharey="row", height_ratios=[side * counts.shape[1] / counts.shape[2], 1.5]
        )
        for image, name, (top, bottom) in zip(sigmas, channel_names, axes.T, strict=True):
            shown = top.imshow(image, cmap="RdBu_r", vmin=-5, vmax=5)
            top.spines[:].set_visible(True)
            top.set(title=name, xlabel="column [pixel]")
            beyond = []
            for (label, rays), colour in zip(groups.items(), (GRAY, BLUE), strict=False):
                density = np.histogram(image[rays], edges)[0] / max(rays.sum(), 1) / np.diff(edges)
                columns[f"{name}_{label.replace(' ', '_')}"] = density
                visible = np.where(density > 0, density, np.nan)
                bottom.stairs(visible, edges, baseline=None, color=colour, linewidth=1.2, label=label)
                beyond.append(f"{100 * np.mean(np.abs(image[rays]) > edges[-1]) if rays.any() else 0:.2g} %")
            bottom.plot(centres, normal, color="black", linewidth=0.8, linestyle=(0, (3, 2)), label="unit normal")
            bottom.set(yscale="log", ylim=(1e-4, 1), xlim=(-6, 6), xticks=[-5, 0, 5], xlabel="residual [σ]")
            narrow = side < 1.1
            title = ("beyond 6σ\n" if narrow else "beyond 6σ: ") + ", ".join(beyond)
            bottom.set_title(title, fontsize=6.0 if narrow else 7.5, color="0.25")
        axes[0, 0].set_ylabel("row [pixel]")
        axes[1, 0].set_ylabel("part of the rays per σ")
        figure.colorbar(shown, ax=axes[0], extend="both", pad=0.01, aspect=14).set_label("(y − Y) / √Y  [σ]")
        figure.legend(*axes[1, 0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    write_csv(path, columns)
    return figure


def convergence(
    seconds: Float[np.ndarray, " step"], deviance: Float[np.ndarray, " step"], path: Path | None = None
) -> "Figure":
    """Draw deviance over that of noise alone against time: every step, and a running mean; with a CSV.

    Parameters
    ----------
    seconds : time since the fit began [s]
    deviance : deviance of the views of each step, over that of noise alone
    path : figure to write, with its CSV where it has one; None for no file

    Returns
    -------
    the figure
    """
    seconds, deviance = np.asarray(seconds, dtype=np.float64), np.asarray(deviance, dtype=np.float64)
    window = max(len(deviance) // 20, 1)
    mean = ndimage.uniform_filter1d(deviance, window, mode="nearest")
    write_csv(path, {"seconds": seconds, "deviance": deviance, "running_mean": mean})
    with figure_file(path, (WIDTH / 2, 2.4)) as figure:
        ax = figure.subplots()
        name = "each step"
        if window > 1:
            ax.plot(seconds, deviance, color="0.75", linewidth=0.6, label=name)
            name = f"mean of {window} steps"
        ax.plot(seconds, mean, color=BLUE, linewidth=1.4, label=name)
        ax.set(xlabel="time [s]", ylabel="deviance / noise alone")
        decades_or_zero(ax, mean)
        ax.legend(loc="upper right")
    return figure


def borders(grid: Grid, axis: str) -> tuple[float, float]:
    """Return the outer faces of a grid along one axis.

    Parameters
    ----------
    grid : grid of a volume
    axis : ``x``, ``y`` or ``z``

    Returns
    -------
    lower and upper face [mm]
    """
    centres, half = grid.axis(axis), grid.spacing["zyx".index(axis)] / 2
    return float(centres[0] - half), float(centres[-1] + half)
