"""Figure of the detectability of an insert: images of both classes, noise power, task transfer, and d' of observers."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from phantomgen.display.figures.style import BLUE, GRAY, PAGE_WIDTH, RESULT, TRUTH, figure_file, write_csv
from recon.detectability.image_quality import ImageQuality

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def draw_quality(found: ImageQuality, path: Path | None = None) -> "Figure":
    """Draw the detectability of an insert, with both spectra as CSV.

    Parameters
    ----------
    found : images, spectra and d'
    path : figure to write, with its CSV where it has one; None for no file

    Returns
    -------
    the figure
    """
    with figure_file(path, (2 * PAGE_WIDTH, 5.6)) as figure:
        axes = figure.subplots(2, 3)
        titles = "with the insert", "without it", "mean difference"
        low, high = np.quantile(found.images[:2], [0.001, 0.999])
        for ax, image, title in zip(axes[0], found.images, titles, strict=True):
            top = float(np.abs(image).max()) or 1.0
            own = title == titles[2]
            limits = {"vmin": -top, "vmax": top} if own else {"vmin": low, "vmax": high}
            drawn = ax.imshow(image, cmap="RdBu_r" if own else "gray", origin="lower", **limits)
            ax.set(xticks=[], yticks=[], title=title)
            figure.colorbar(drawn, ax=ax, fraction=0.046, pad=0.03)
        axes[0, 0].set_ylabel(f"{found.about}\n[{found.unit}]")
        axes[1, 0].plot(found.frequency, found.power, color=RESULT)
        axes[1, 0].set(
            title="noise power spectrum",
            xlabel="frequency [1/mm]",
            ylabel=f"[({found.unit})$^2$ mm$^2$]",
            ylim=(0, None),
        )
        axes[1, 1].set(title="task transfer function", xlabel="frequency [1/mm]", ylim=(0, 1.1))
        if len(found.task_frequency):
            axes[1, 1].plot(found.task_frequency, found.task_transfer, color=RESULT)
        else:
            axes[1, 1].text(
                0.5, 0.5, "the insert is too small", ha="center", transform=axes[1, 1].transAxes, color=GRAY
            )
        _observers(axes[1, 2], found)
        if path is not None:
            write_csv(path, {"frequency_per_mm": found.frequency, "noise_power": found.power})
    return figure


def _observers(ax: "Axes", found: ImageQuality) -> None:
    """Draw d' of the observers with their intervals, below the ceiling."""
    for place, (one, colour) in enumerate(((found.without_prewhitening, BLUE), (found.hotelling, RESULT))):
        ax.bar(place, one.value, color=colour, width=0.6)
        ax.errorbar(place, one.value, [[one.value - one.low], [max(one.high - one.value, 0)]], color="black", capsize=4)
    ax.axhline(found.ideal, color=TRUTH, linestyle="--")
    white = {"facecolor": "white", "edgecolor": "none", "pad": 1.0}
    label = "ideal observer of counts"
    ax.text(1.55, 1.03 * found.ideal, label, ha="right", va="bottom", fontsize="small", bbox=white)
    ax.set(
        title="detectability index d'",
        xticks=[0, 1],
        xticklabels=["without\nprewhitening", "channelised\nHotelling"],
        xlim=(-0.6, 1.6),
        ylim=(0, 1.2 * max(found.ideal, found.hotelling.high, found.without_prewhitening.high)),
    )
