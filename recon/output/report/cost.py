"""Cost of runs: Gaussians or voxels, seconds, memory."""

import numpy as np

from phantomgen.display.html import Code, Part, Table
from phantomgen.display.html.content import csv_of
from recon.output.report.case import Case, Parts, number
from recon.output.report.finished_run import FinishedRun


def parts(case: Case) -> Parts:
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
