"""Figures of measured data: single views, and sinograms of one row of pixels."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Real

from phantomgen.dataset.reader import Dataset
from phantomgen.display.figures.style import PAGE_WIDTH, few_ticks, figure_file, write_csv

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_VIEWS = 240  # rows of a sinogram; of more views, so many are picked evenly
LOG = "−log(counts / open beam)"


def view_images(
    columns: Sequence[tuple[str, Real[np.ndarray, "channel row column"]]],
    channels: Sequence[str],
    path: Path | None = None,
) -> "Figure":
    """Draw one view, a row of images per channel; with a CSV of ranges.

    Images of the same title have one scale within a row.

    Parameters
    ----------
    columns : titles and images, such as counts and log projections; NaN where a pixel does not measure
    channels : names
    path : figure to write, with its CSV where it has one; None for no file

    Returns
    -------
    the figure
    """
    titles = [title for title, _ in columns]
    groups = {title.partition(", ")[0]: None for title in titles}
    _, rows, width = columns[0][1].shape
    ratios: list[float] = []
    for group in groups:
        ratios += [1.0] * sum(title.partition(", ")[0] == group for title in titles) + [0.06]
    side = (PAGE_WIDTH - 0.55 - 0.55 * len(groups)) / len(columns)
    table: dict[str, Any] = {}
    with figure_file(path, (PAGE_WIDTH, (side * rows / width + 0.1) * len(channels) + 0.55)) as figure:
        axes = figure.subplots(len(channels), len(ratios), width_ratios=ratios, squeeze=False)
        for c, channel in enumerate(channels):
            place = 0
            for group in groups:
                images = [(t, image[c]) for t, image in columns if t.partition(", ")[0] == group]
                _draw_images(figure, axes[c, place : place + len(images) + 1], images, c == 0)
                place += len(images) + 1
            axes[c, 0].set_ylabel(channel)
        for title, image in columns:
            key = title.replace(", ", "_").replace(" ", "_")
            for word, value in (("lowest", np.nanmin), ("mean", np.nanmean), ("highest", np.nanmax)):
                table[f"{key}_{word}"] = np.array([_or_nan(value, image[c]) for c in range(len(channels))])
    write_csv(path, {"channel": np.arange(len(channels)), **table})
    return figure


def sinograms(dataset: Dataset, path: Path | None = None) -> "Figure":
    """Draw log projections of the middle row of pixels in the training views, per channel.

    A CSV of the first channel lies beside the picture.

    Parameters
    ----------
    dataset : open dataset
    path : figure to write, with its CSV where it has one; None for no file

    Returns
    -------
    the figure
    """
    views, up, label = _ordered(dataset)
    row = dataset.counts.shape[2] // 2
    images = np.stack([dataset.line_integrals(int(view))[:, row] for view in views], axis=1)
    channels = dataset.spectra.channels
    across = 2 if len(channels) > 1 else 1
    down = -(-len(channels) // across)
    top = float(np.nanquantile(images, 0.999))
    columns = images.shape[2]
    extent = (-0.5, columns - 0.5, float(up[0]), float(up[-1]) if up[-1] != up[0] else float(up[0]) + 1)
    with figure_file(path, (PAGE_WIDTH, 1.5 * down + 0.5)) as figure:
        axes = figure.subplots(down, across, sharex=True, sharey=True, squeeze=False)
        for ax in axes.flat[len(channels) :]:
            ax.axis("off")
        for ax, image, channel in zip(axes.flat, images, channels, strict=False):
            shown = ax.imshow(image, cmap="gray", vmin=0, vmax=top, aspect="auto", origin="lower", extent=extent)
            ax.set_title(channel)
            ax.spines[:].set_visible(True)
        for ax in axes[-1]:
            ax.set_xlabel("column [pixel]")
        for ax in axes[:, 0]:
            ax.set_ylabel(label)
        figure.colorbar(shown, ax=axes, extend="both", pad=0.02, aspect=30).set_label(LOG)
    write_csv(path, {"view": views, label.replace(" ", "_"): up, "mean_log": np.nanmean(images[0], axis=1)})
    return figure


def _ordered(dataset: Dataset) -> tuple[np.ndarray, np.ndarray, str]:
    """Training views in the order of their angles [degree], or of their numbers where they have none."""
    train = dataset.splits["train"]
    views = train if len(train) else np.arange(dataset.counts.shape[0])
    angles = np.rad2deg(dataset.geometry.angles[views])
    if np.isfinite(angles).all():
        order = np.argsort(angles, kind="stable")
        views, up, label = views[order], angles[order], "angle [degree]"
    else:
        up, label = np.asarray(views, dtype=np.float64), "view"
    picked = np.unique(np.linspace(0, len(views) - 1, min(len(views), MOST_VIEWS)).round().astype(int))
    return views[picked], up[picked], label


def _draw_images(figure: "Figure", axes: Any, images: list[tuple[str, np.ndarray]], first: bool) -> None:
    """Images with one scale, and their colour bar."""
    values = np.concatenate([image[np.isfinite(image)] for _, image in images])
    low, high = np.quantile(values, [0.001, 0.999]) if values.size else (0.0, 1.0)
    for ax, (title, image) in zip(axes, images, strict=False):
        shown = ax.imshow(image, cmap="gray", vmin=min(low, 0.0) if high > 0 else low, vmax=high or 1.0)
        _bare(ax)
        if first:
            ax.set_title(title.replace(", ", "\n"))
    bar = figure.colorbar(shown, cax=axes[-1], extend="max")
    bar.outline.set_linewidth(0.6)  # type: ignore[operator]
    bar.locator = few_ticks()


def _bare(ax: "Axes") -> None:
    """A frame without numbers."""
    ax.spines[:].set_visible(True)
    ax.set_xticks([])
    ax.set_yticks([])


def _or_nan(reduce: Any, image: np.ndarray) -> float:
    return float(reduce(image)) if np.isfinite(image).any() else float("nan")
