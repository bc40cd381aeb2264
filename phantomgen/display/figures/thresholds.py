"""Figure of chosen thresholds: the least noise against each of them, with the others at their best values."""

from pathlib import Path

import numpy as np

from phantomgen.analysis.thresholds import ThresholdChoice
from phantomgen.display.figures.scan_energies import draw_edges
from phantomgen.display.figures.style import GRID, channel_colours, check_picture, figure_file
from spectra.basis.basis import pretty

_HIGHEST = 1.6  # times the least noise


def write_figure(choice: ThresholdChoice, path: Path | str) -> Path:
    """Draw the bound over each threshold as PNG, PDF or SVG.

    Dots are the chosen thresholds; the dashed line is the bound of the thresholds before.

    Parameters
    ----------
    choice : chosen thresholds
    path : the picture

    Returns
    -------
    path of the picture
    """
    path = Path(path)
    check_picture(path)
    candidates, chosen = choice.candidates, choice.chosen
    with figure_file(path, (6.5, 4.0)) as figure:
        axes = figure.subplots()
        for i, colour in enumerate(channel_colours(len(chosen) - 1), start=1):
            places = candidates.moved(chosen, i)[1:]
            threshold = candidates.thresholds[places[:, i]]
            best = candidates.thresholds[chosen[i]]
            axes.plot(threshold, candidates.bounds(places), color=colour, linewidth=1.6, label=f"{best:g} keV")
            axes.plot(best, choice.bound, "o", color=colour, markersize=6)
        if np.isfinite(choice.old_bound):
            axes.axhline(choice.old_bound, color="0.3", linewidth=1.0, linestyle="--", label="scene as it is")
        if np.isfinite(choice.bound):
            axes.set_ylim(0.97 * choice.bound, _HIGHEST * choice.bound)
        axes.set_xlim(candidates.thresholds[0], choice.scan.source.maximum)
        draw_edges([axes], choice.scan, candidates.thresholds[0])
        axes.set_xlabel("threshold [keV]")
        axes.set_ylabel("least noise of the line integral [1]")
        axes.set_title(f"{choice.scan.name}: {pretty(choice.basis)} behind {choice.behind or 'nothing'}")
        axes.grid(color=GRID, linewidth=0.5)
        axes.set_axisbelow(True)
        figure.legend(title="best threshold", fontsize=8, title_fontsize=8, loc="outside right upper")
    return path
