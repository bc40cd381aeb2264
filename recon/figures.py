"""Pictures of a run, each with its numbers as CSV beside it where it shows curves.

Every function takes arrays, writes a PNG and returns its path; matplotlib is imported when the first one is drawn.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float, Real
from scipy import ndimage

from phantomgen.grid import Grid

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WIDTH = 7.0  # inches: one column
RESULT, TRUTH = "#D55E00", "black"
MILLI, UNIT = 1e3, "10$^{-3}$ mm$^{-1}$"  # what coefficients are drawn in
_STYLE = {
    "font.size": 8.5,
    "axes.titlesize": 9.0,
    "axes.labelsize": 8.5,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "legend.frameon": False,
    "legend.fontsize": 8.0,
    "lines.linewidth": 1.2,
    "lines.solid_joinstyle": "round",
    "axes.formatter.limits": (-3, 5),
    "axes.formatter.use_mathtext": True,
    "image.interpolation": "nearest",
}
_GRAY, _BLUE = "0.6", "#0072B2"
_BASIS_LINES = ((_BLUE, "-"), ("#E69F00", (0, (6, 2))), ("#CC79A7", (0, (2.5, 2))), ("#009E73", (0, (1, 1))))
_PLANES = {"axial": (0, "x", "y"), "coronal": (1, "x", "z"), "sagittal": (2, "y", "z")}
_NAMES = {"photoelectric": "photoelectric", "compton": "Compton"}


def basis_slices(
    volumes: Real[np.ndarray, "basis z y x"],
    truth: Real[np.ndarray, "basis z y x"] | None,
    names: Sequence[str],
    grid: Grid,
    path: Path,
    plane: str = "axial",
) -> Path:
    """Middle slice of every basis: truth, result and their difference, or the result alone.

    Parameters
    ----------
    volumes, truth : coefficients [1/mm]
    names : names of the basis functions
    plane : ``axial`` (x, y), ``coronal`` (x, z) or ``sagittal`` (y, z)
    """
    axis, across, up = _PLANES[plane]
    middle = grid.shape[axis] // 2
    place = f"{'zyx'[axis]} = {grid.axis('zyx'[axis])[middle]:.3g} mm"
    extent = [*_borders(grid, across), *_borders(grid, up)]
    result = volumes.take(middle, axis=axis + 1)
    true = None if truth is None else truth.take(middle, axis=axis + 1)
    titles = ["result"] if true is None else ["truth", "result", "result − truth"]
    ratios = [1, 0.06] if true is None else [1, 1, 0.06, 1, 0.06]
    side = 1.85 if true is None else 1.6
    high = side * (extent[3] - extent[2]) / (extent[1] - extent[0])
    with _figure(path, (WIDTH if true is not None else 3.2, (high + 0.14) * len(names) + 0.75)) as figure:
        axes = figure.subplots(len(names), len(ratios), width_ratios=ratios, squeeze=False)
        pictures = axes[:, [0]] if true is None else axes[:, [0, 1, 3]]
        for row, name in enumerate(names):
            _draw_row(figure, axes[row], result[row], None if true is None else true[row], extent)
            pictures[row, 0].set_ylabel(f"{_pretty(name)}\n{up} [mm]")
        for ax in pictures.flat:
            ax.spines[:].set_visible(True)
            ax.tick_params(labelbottom=ax in pictures[-1], labelleft=ax in pictures[:, 0])
        for top, bottom, title in zip(pictures[0], pictures[-1], titles, strict=True):
            top.set_title(title)
            bottom.set_xlabel(f"{across} [mm]")
        figure.suptitle(f"{plane} slice, {place}", fontsize=9.0)
    return path


def _draw_row(figure: "Figure", axes: Any, result: np.ndarray, true: np.ndarray | None, extent: list[float]) -> None:
    """One basis: images with one grey scale, the difference with its own."""
    pictures = [result] if true is None else [true, result]
    top = float(np.quantile(result, 0.999) if true is None else true.max()) or float(np.abs(result).max()) or 1.0
    options = {"extent": extent, "origin": "lower"}
    for ax, picture in zip(axes, pictures, strict=False):
        gray = ax.imshow(MILLI * picture, cmap="gray", vmin=0, vmax=MILLI * top, **options)
    ends = "max" if result.min() >= 0 else "both"
    bars = [figure.colorbar(gray, cax=axes[len(pictures)], extend=ends)]
    if true is not None:
        limit = float(np.quantile(np.abs(result - true), 0.995)) or 1e-3 * top
        error = axes[3].imshow(
            MILLI * (result - true), cmap="RdBu_r", vmin=-MILLI * limit, vmax=MILLI * limit, **options
        )
        bars.append(figure.colorbar(error, cax=axes[4], extend="both"))
    for bar in bars:
        bar.set_label(UNIT)
        bar.outline.set_linewidth(0.6)
        bar.locator = _few_ticks()


def profiles(
    volumes: Real[np.ndarray, "basis z y x"],
    truth: Real[np.ndarray, "basis z y x"] | None,
    names: Sequence[str],
    grid: Grid,
    path: Path,
    line: Float[np.ndarray, "2 3"] | None = None,
) -> Path:
    """Every basis along one line, with a CSV.

    Parameters
    ----------
    volumes, truth : coefficients [1/mm]
    line : two points (x, y, z) [mm] that the line joins; `profile_line` of the last basis where left out
    """
    line = profile_line(volumes[-1], grid) if line is None else np.asarray(line, dtype=np.float64)
    length = float(np.linalg.norm(line[1] - line[0]))
    position = np.arange(0.0, length, min(grid.spacing) / 2)
    points = line[0] + position[:, None] / length * (line[1] - line[0])
    index = ((points[:, ::-1] - grid.origin) / grid.spacing).T
    result = np.array([ndimage.map_coordinates(v, index, order=1, mode="nearest") for v in volumes])
    columns = {"position_mm": position} | {f"{c}_mm": points[:, i] for i, c in enumerate("xyz")}
    columns |= {f"{name}_result": row for name, row in zip(names, result, strict=True)}
    if truth is not None:
        true = [ndimage.map_coordinates(v, index, order=0, mode="nearest") for v in truth]
        columns |= {f"{name}_truth": row for name, row in zip(names, true, strict=True)}
    _write_csv(path, columns)
    ends = " to ".join("({:.0f}, {:.0f}, {:.0f})".format(*point) for point in line)
    with _figure(path, (WIDTH, 1.45 * len(names) + 0.7)) as figure:
        axes = figure.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0]
        for ax, name in zip(axes, names, strict=True):
            ax.plot(position, MILLI * columns[f"{name}_result"], color=RESULT, label="result")
            if truth is not None:
                true = MILLI * columns[f"{name}_truth"]
                ax.step(position, true, where="mid", color=TRUTH, linewidth=0.7, label="truth")
            ax.text(0.01, 0.97, _pretty(name), transform=ax.transAxes, va="top", fontsize=9)
            ax.set_ylabel(UNIT)
            ax.margins(x=0)
        axes[0].legend(loc="upper right", ncols=2, bbox_to_anchor=(1, 1.22), borderaxespad=0)
        axes[0].set_title(f"profile from (x, y, z) = {ends} mm", loc="left")
        axes[-1].set_xlabel("position along the line [mm]")
        figure.align_ylabels()
    return path


def profile_line(volume: Real[np.ndarray, "z y x"], grid: Grid) -> Float[np.ndarray, "2 3"]:
    """A line inside one axial slice through the two strongest regions of a volume, or along x through the only one.

    Returns
    -------
    Where it enters and leaves the grid, (x, y, z) [mm]. The slice is the middle one, or that of the largest value where
    nothing is in the middle.
    """
    smooth = ndimage.uniform_filter(np.asarray(volume, dtype=np.float64), 5)
    middle = grid.shape[0] // 2
    if smooth[middle].max() < 0.3 * smooth.max():
        middle = int(np.unravel_index(smooth.argmax(), smooth.shape)[0])
    labels, count = ndimage.label(smooth[middle] > 0.3 * smooth[middle].max())
    regions = range(1, count + 1)
    order = np.argsort(-np.asarray(ndimage.sum_labels(smooth[middle], labels, regions)))
    centres = [ndimage.center_of_mass(labels == regions[i]) for i in order[:2]] or [(grid.shape[1] // 2, 0.0)]
    points = np.array(centres)[:, ::-1] * grid.spacing[:0:-1] + grid.origin[:0:-1]
    direction = points[1] - points[0] if len(points) == 2 else np.array([1.0, 0.0])
    low, high = np.array([_borders(grid, c) for c in "xy"]).T
    with np.errstate(divide="ignore", invalid="ignore"):
        steps = np.sort([(low - points[0]) / direction, (high - points[0]) / direction], axis=0)
    ends = points[0] + np.array([[np.nanmax(steps[0])], [np.nanmin(steps[1])]]) * direction
    ends = ends if ends[0, 0] <= ends[1, 0] else ends[::-1]
    return np.column_stack([ends, np.full(2, grid.axis("z")[middle])])


def residuals(
    counts: Real[np.ndarray, "channel row column"],
    expected: Real[np.ndarray, "channel row column"],
    channel_names: Sequence[str],
    path: Path,
    away: Bool[np.ndarray, "row column"] | None = None,
) -> Path:
    """(y - Y) / sqrt(Y) of one held-out view, per channel, with histograms against the unit normal and their CSV.

    Parameters
    ----------
    counts, expected : measured y and modelled Y of one view
    away : rays away from edges, drawn as a second histogram
    """
    sigmas = (counts - expected) / np.sqrt(np.maximum(expected, 1e-9))
    edges = np.linspace(-6, 6, 61)
    centres = (edges[1:] + edges[:-1]) / 2
    normal = np.exp(-(centres**2) / 2) / np.sqrt(2 * np.pi)
    groups = {"all rays": np.ones(counts.shape[1:], bool)} | ({} if away is None else {"away from edges": away})
    columns = {"sigma": centres, "unit_normal": normal}
    side = min(5.4 / len(counts), 3.0)
    with _figure(path, (WIDTH, side * counts.shape[1] / counts.shape[2] + 3.0)) as figure:
        axes = figure.subplots(
            2, len(counts), squeeze=False, sharey="row", height_ratios=[side * counts.shape[1] / counts.shape[2], 1.5]
        )
        for image, name, (top, bottom) in zip(sigmas, channel_names, axes.T, strict=True):
            shown = top.imshow(image, cmap="RdBu_r", vmin=-5, vmax=5)
            top.spines[:].set_visible(True)
            top.set(title=name, xlabel="column [pixel]")
            beyond = []
            for (label, rays), colour in zip(groups.items(), (_GRAY, _BLUE), strict=False):
                density = np.histogram(image[rays], edges)[0] / max(rays.sum(), 1) / np.diff(edges)
                columns[f"{name}_{label.replace(' ', '_')}"] = density
                visible = np.where(density > 0, density, np.nan)
                bottom.stairs(visible, edges, baseline=None, color=colour, linewidth=1.2, label=label)
                beyond.append(f"{100 * np.mean(np.abs(image[rays]) > edges[-1]) if rays.any() else 0:.2g} %")
            bottom.plot(centres, normal, color="black", linewidth=0.8, linestyle=(0, (3, 2)), label="unit normal")
            bottom.set(yscale="log", ylim=(1e-4, 3), xlim=(-6, 6), xticks=[-5, 0, 5], xlabel="residual [σ]")
            bottom.set_title("beyond 6σ: " + ", ".join(beyond), fontsize=7.5, color="0.25")
        axes[0, 0].set_ylabel("row [pixel]")
        axes[1, 0].set_ylabel("part of the rays per σ")
        figure.colorbar(shown, ax=axes[0], extend="both", pad=0.01, aspect=14).set_label("(y − Y) / √Y  [σ]")
        figure.legend(*axes[1, 0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    _write_csv(path, columns)
    return path


def spectrum(
    energy: Float[np.ndarray, " energy"],
    edges: Float[np.ndarray, " energy_plus_1"],
    source: Float[np.ndarray, " energy"],
    response: Float[np.ndarray, "channel energy"],
    channel_names: Sequence[str],
    basis_names: Sequence[str],
    basis_values: Float[np.ndarray, "basis energy"],
    path: Path,
    k_edges: Sequence[float] = (),
) -> Path:
    """Source and what each channel counts of it, per keV, above the basis functions; with a CSV of all bins.

    Parameters
    ----------
    energy, edges : mean energy and borders of the bins [keV]
    source : incident photons per bin
    response : counts per photon
    basis_values : basis functions at `energy` [no unit]
    k_edges : energies to mark [keV], `Basis.breaks`
    """
    counted = source * response
    columns = {"energy_keV": energy, "bin_low_keV": edges[:-1], "bin_high_keV": edges[1:], "source": source}
    columns |= {f"{name}_counts": row for name, row in zip(channel_names, counted, strict=True)}
    columns |= {f"basis_{name}": row for name, row in zip(basis_names, basis_values, strict=True)}
    _write_csv(path, columns)
    with _figure(path, (WIDTH, 4.6)) as figure:
        top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=[1.25, 1])
        display = _display_bins(edges, response)
        colours = _colours(len(channel_names))
        for name, row, colour in zip(channel_names, counted, colours, strict=True):
            top.stairs(
                _per_keV(row, edges, display), display, fill=True, color=colour, alpha=0.75, linewidth=0, label=name
            )
        top.stairs(_per_keV(source, edges, display), display, color="black", linewidth=0.9, label="incident")
        top.set_ylabel("photons per pixel, view and keV")
        top.set_ylim(bottom=0)
        for i, (name, row) in enumerate(zip(basis_names, basis_values, strict=True)):
            colour, dashes = _BASIS_LINES[i % len(_BASIS_LINES)]
            visible = np.maximum(row, 1e-9)  # a step then falls off the logarithmic axis
            marker = "o" if len(energy) == 1 else None
            bottom.plot(energy, visible, color=colour, linestyle=dashes, marker=marker, label=_pretty(name))
        lowest = basis_values[basis_values > 0].min(initial=1.0)
        scale = "log" if len(energy) > 1 else "linear"
        bottom.set(yscale=scale, ylim=(lowest / 1.5, basis_values.max() * 1.5), xlabel="energy [keV]")
        bottom.set_ylabel("basis functions [no unit]")
        for edge in k_edges:
            for ax in (top, bottom):
                ax.axvline(edge, color="0.35", linewidth=0.7, linestyle=(0, (2, 2)), zorder=0)
            top.annotate(
                f"K edge {edge:g} keV", (edge, 1), xycoords=("data", "axes fraction"), ha="center", va="bottom"
            )
        top.set_xlim(*_shown_range(edges))
        top.legend(loc="upper right")
        bottom.legend(loc="upper right")
        bottom.yaxis.set_major_formatter("{x:g}")
        figure.align_ylabels()
    return path


def convergence(seconds: Float[np.ndarray, " step"], deviance: Float[np.ndarray, " step"], path: Path) -> Path:
    """Deviance per count value against time: every step, and a running mean; with a CSV.

    Parameters
    ----------
    seconds : since the fit began [s]
    deviance : mean deviance of the views of each step, about 1 where model and noise agree
    """
    seconds, deviance = np.asarray(seconds, dtype=np.float64), np.asarray(deviance, dtype=np.float64)
    window = max(len(deviance) // 20, 1)
    mean = ndimage.uniform_filter1d(deviance, window, mode="nearest")
    _write_csv(path, {"seconds": seconds, "deviance": deviance, "running_mean": mean})
    with _figure(path, (WIDTH / 2, 2.4)) as figure:
        ax = figure.subplots()
        ax.plot(seconds, deviance, color="0.75", linewidth=0.6, label="each step")
        ax.plot(seconds, mean, color=_BLUE, linewidth=1.4, label=f"mean of {window} steps")
        ax.axhline(1, color="black", linewidth=0.7, linestyle=(0, (3, 2)))
        ax.set(yscale="log", xlabel="time [s]", ylabel="mean deviance [no unit]")
        ax.yaxis.set_major_formatter("{x:g}")
        ax.yaxis.set_minor_formatter(_plain_minor_ticks())
        ax.legend(loc="upper right")
    return path


@contextmanager
def _figure(path: Path, inches: tuple[float, float]) -> Iterator["Figure"]:
    """A figure in the house style that is written as PNG at the end, whatever backend the process uses."""
    from matplotlib import rc_context  # noqa: PLC0415 - half a second
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415
    from matplotlib.figure import Figure  # noqa: PLC0415

    with rc_context(_STYLE):
        figure = Figure(figsize=inches, dpi=150, layout="constrained")
        FigureCanvasAgg(figure)
        yield figure
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        figure.draw_without_rendering()  # the layout settles in two rounds where aspect ratios are fixed
        figure.savefig(path, format="png", metadata={"Software": None})


def _write_csv(path: Path, columns: dict[str, np.ndarray]) -> None:
    """Equally long columns, beside the picture."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    table = np.column_stack(list(columns.values()))
    np.savetxt(path.with_suffix(".csv"), table, fmt="%.6g", delimiter=",", header=",".join(columns), comments="")


def _pretty(name: str) -> str:
    """A basis function's name for readers."""
    if name.startswith("kedge_"):
        what = name.removeprefix("kedge_")
        return f"K-edge {what} keV" if what[:1].isdigit() else f"K-edge {what}"
    return _NAMES.get(name, name)


def _borders(grid: Grid, axis: str) -> tuple[float, float]:
    """Outer faces of the grid along one axis [mm]."""
    centres, half = grid.axis(axis), grid.spacing["zyx".index(axis)] / 2
    return float(centres[0] - half), float(centres[-1] + half)


def _display_bins(edges: np.ndarray, response: np.ndarray) -> np.ndarray:
    """Borders of bins of about 1 keV, in which lines get the height of their photons; channels end on borders [keV]."""
    low, high = _shown_range(edges)
    ends = edges[1:-1][np.any((response[:, 1:] > 0) != (response[:, :-1] > 0), axis=0)]
    stops = np.unique([low, *ends, high])
    parts = [np.linspace(a, b, max(round(b - a), 1), endpoint=False) for a, b in pairwise(stops)]
    return np.concatenate([*parts, [high]])


def _per_keV(photons: np.ndarray, edges: np.ndarray, display: np.ndarray) -> np.ndarray:
    """Photons per keV in the bins with borders `display`."""
    total = np.interp(display, edges, np.concatenate([[0.0], np.cumsum(photons)]))
    return np.diff(total) / np.diff(display)


def _shown_range(edges: np.ndarray) -> tuple[float, float]:
    """Energies to show [keV]: all, widened to 10 keV for a monochromatic source."""
    middle, half = (edges[0] + edges[-1]) / 2, (edges[-1] - edges[0]) / 2
    return (float(edges[0]), float(edges[-1])) if half >= 5 else (middle - 5.5, middle + 5.5)


def _few_ticks() -> Any:
    from matplotlib.ticker import MaxNLocator  # noqa: PLC0415

    return MaxNLocator(5, steps=[1, 2, 5, 10])


def _plain_minor_ticks() -> Any:
    """Numbers at minor ticks of a logarithmic axis that spans less than a decade."""
    from matplotlib.ticker import LogFormatter  # noqa: PLC0415

    return LogFormatter(minor_thresholds=(1, 0.5))


def _colours(count: int) -> Any:
    """Distinct colours in order of energy, dark to light."""
    from matplotlib import colormaps  # noqa: PLC0415

    return colormaps["viridis"](np.linspace(0.1, 0.95, count))
