"""Error against time and against iteration, of all runs."""

from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import uniform_filter1d

from phantomgen.display.figures.style import PAGE_WIDTH, decades_or_zero, figure_file
from phantomgen.display.html import picture
from phantomgen.display.html.content import csv_of
from recon.output.report.case import LINES, Case, LeftOut, Parts
from spectra.basis.basis import pretty

MISFIT = ("deviance", "residual")  # names of the misfit to the counts in a log


def parts(case: Case) -> Parts:
    """Draw one row per basis, and one for the misfit to the counts.

    Parameters
    ----------
    case : runs of the report

    Returns
    -------
    parts of the page

    Raises
    ------
    LeftOut
        When no run has a log.
    """
    logs = {case.label(run): run.log for run in case.runs if run.log}
    if not logs:
        raise LeftOut("the runs have no log")
    rows = [n for n in case.names if any(f"psnr_{n}" in entry for log in logs.values() for entry in log)]
    path = progress_figure(logs, rows, case.path("progress"))
    caption = (
        "Error against time and against steps or iterations: PSNR of intermediate models, and their misfit to the "
        "counts of the views of each step: for Gaussians the deviance over that of noise alone, else the residual of "
        "the method on voxels. Time starts with the fit, after its initial volumes."
    )
    return (picture(path, caption, _table(logs)),)


def progress_figure(logs: dict[str, tuple[dict[str, Any], ...]], names: list[str], path: Path) -> Path:
    """Draw PSNR of each basis, and the misfit, against seconds and steps.

    Parameters
    ----------
    logs : entries of the log of each run, by the names of the runs
    names : names of the bases
    path : figure to write

    Returns
    -------
    path
    """
    with figure_file(path, (PAGE_WIDTH, 1.15 * (len(names) + 1) + 0.7)) as figure:
        axes = figure.subplots(len(names) + 1, 2, sharex="col", sharey="row", squeeze=False)
        for (label, log), (colour, dashes) in zip(logs.items(), LINES, strict=False):
            style = {"color": colour, "linestyle": dashes, "label": label}
            for row, name in zip(axes, names, strict=False):
                some = [entry for entry in log if entry.get(f"psnr_{name}") is not None]
                values = [entry[f"psnr_{name}"] for entry in some]
                for ax, place in zip(row, (_seconds(some), _steps(some)), strict=True):
                    ax.plot(place, values, marker=".", markersize=4, **style)
            key = next((k for k in MISFIT if any(k in entry for entry in log)), MISFIT[0])
            some = [entry for entry in log if entry.get(key) is not None]
            if some:
                mean = uniform_filter1d([float(e[key]) for e in some], max(len(some) // 20, 1), mode="nearest")
                for ax, place in zip(axes[-1], (_seconds(some), _steps(some)), strict=True):
                    ax.plot(place, mean, **style)
        for ax, name in zip(axes[:, 0], names, strict=False):
            ax.set_ylabel("PSNR [dB]")
            ax.text(0.98, 0.06, pretty(name), transform=ax.transAxes, ha="right", fontsize=8)
        for ax in axes[-1]:
            decades_or_zero(ax, np.concatenate([line.get_ydata() for line in ax.get_lines()] or [np.zeros(0)]))
        axes[-1, 0].set(xlabel="time of the fit [s]", ylabel="misfit")
        axes[-1, 1].set(xlabel="step or iteration")
        if len(logs) > 1:
            figure.legend(*axes[-1, 0].get_legend_handles_labels(), loc="outside upper right", ncols=3)
        figure.align_ylabels()
    return path


def _seconds(entries: list[dict[str, Any]]) -> np.ndarray:
    """Time of the entries [s]."""
    return np.array([float(entry["seconds"]) for entry in entries])


def _steps(entries: list[dict[str, Any]]) -> np.ndarray:
    """Step or iteration of the entries."""
    return np.array([int(entry.get("step", entry.get("iteration", 0))) for entry in entries])


def _table(logs: dict[str, tuple[dict[str, Any], ...]]) -> str:
    """All entries of all logs as CSV."""
    keys = list(dict.fromkeys(key for log in logs.values() for entry in log for key in entry))
    rows = [(label, *(entry.get(key, "") for key in keys)) for label, log in logs.items() for entry in log]
    return csv_of(("run", *keys), rows)
