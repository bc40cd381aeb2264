"""Error against time and iteration of all runs, and their cost: Gaussians or voxels, seconds, memory."""

from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import uniform_filter1d

from phantomgen.display.figures.style import PAGE_WIDTH, decades_or_zero, figure_file
from phantomgen.display.html import Code, Part, Table, picture
from phantomgen.display.html.content import csv_of
from recon.output.report.case import LINES, Case, LeftOut, Parts, number
from recon.output.report.finished_run import FinishedRun
from spectra.basis.basis import pretty

MISFIT = ("deviance", "residual")  # names of the misfit to the counts in a log


def progress_parts(case: Case) -> Parts:
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


def cost_parts(case: Case) -> Parts:
    """Create the table of costs, and the recipe and versions of each run.

    Parameters
    ----------
    case : runs of the report

    Returns
    -------
    parts of the page
    """
    header = ("run", "method", "unknowns", "time [s]", "longest stages [s]", "peak memory [MiB]", "program")
    table = csv_of(
        ("run", "method", "gaussians", "voxels", "peak_memory_mib", "stage", "seconds"),
        [
            (run.name, run.method, run.metrics.get("gaussians", ""), voxels(run), memory(run), stage, seconds)
            for run in case.runs
            for stage, seconds in run.metrics.get("seconds", {}).items()
        ],
    )
    caption = "Wall time on the machine of the run, with its longest stages; figures and scores are included."
    found: list[Part] = [Table(header, tuple(_row(run) for run in case.runs), caption, "cost", table)]
    found += [Code(f"Recipe of {run.name}", run.recipe) for run in case.runs if run.recipe]
    found += [Code(f"Versions of {run.name}", _versions(run)) for run in case.runs if run.metrics.get("versions")]
    return tuple(found)


def seconds(run: FinishedRun) -> float:
    """Add up the time of all stages of a run.

    Parameters
    ----------
    run : a run

    Returns
    -------
    wall time [s]
    """
    return float(sum(run.metrics.get("seconds", {}).values()))


def memory(run: FinishedRun) -> float | None:
    """Return the peak memory of a run.

    Parameters
    ----------
    run : a run

    Returns
    -------
    peak memory [MiB]; None where it is not known
    """
    return run.metrics.get("peak_memory_mib")


def voxels(run: FinishedRun) -> int:
    """Return the number of voxels of a run.

    Parameters
    ----------
    run : a run

    Returns
    -------
    number of voxels
    """
    return int(np.prod(run.grid.shape))


def size(run: FinishedRun) -> str:
    """Describe the size of a model.

    Parameters
    ----------
    run : a run

    Returns
    -------
    number of Gaussians, or shape of the grid of voxels, as text
    """
    if "gaussians" in run.metrics:
        return f"{run.metrics['gaussians']:,} Gaussians"
    return f"{' x '.join(map(str, run.grid.shape))} voxels"


def _row(run: FinishedRun) -> tuple[str, ...]:
    """Cells of a run."""
    stages = sorted(run.metrics.get("seconds", {}).items(), key=lambda item: -item[1])
    longest = ", ".join(f"{name} {value:.1f}" for name, value in stages[:3])
    program = run.metrics.get("versions", {}).get("spectral-ct", "")
    return (run.name, run.method, size(run), number(seconds(run), ".0f"), longest, number(memory(run), ".0f"), program)


def _versions(run: FinishedRun) -> str:
    """Versions of the packages of a run, one per line."""
    return "\n".join(f"{name} {version}" for name, version in run.metrics["versions"].items())
