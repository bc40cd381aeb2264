"""Figures of volumes: three planes, and profiles."""

from pathlib import Path

import numpy as np

from phantomgen.display.figures.style import PAGE_WIDTH, write_csv
from phantomgen.display.html import Part, picture
from recon.figures import run_figures as figures
from recon.output.report.case import Case, Parts

PLANES = ("axial", "coronal", "sagittal")


def parts(case: Case) -> Parts:
    """Draw every basis of every run in three planes.

    Parameters
    ----------
    case : runs of the report

    Returns
    -------
    parts of the page
    """
    found: list[Part] = []
    for i, run in enumerate(case.runs):
        volumes, suffix = case.volumes(run), "" if i == 0 else f"_{i}"
        for plane in PLANES:
            path = case.path(f"{plane}{suffix}")
            figure = figures.basis_slices(volumes, case.true, case.names, case.grid, path, plane, PAGE_WIDTH)
            case.drawn(path, figure)
            _write_numbers(volumes, case, plane, path)
            what = "truth, result and difference" if case.true is not None else "result"
            found.append(
                picture(
                    path, f"{case.who(run)}{plane.capitalize()} slice of every basis: {what}. The table has its errors."
                )
            )
    return tuple(found)


def profile_parts(case: Case) -> Parts:
    """Draw all runs along one line through edges.

    Parameters
    ----------
    case : runs of the report

    Returns
    -------
    parts of the page
    """
    results = {case.label(run): case.volumes(run) for run in case.runs}
    strongest = results[case.label(case.runs[0])] if case.true is None else case.true
    line = figures.profile_line(strongest[-1], case.grid)
    path = case.path("profiles")
    case.drawn(path, figures.profiles(results, case.true, case.names, case.grid, path, line, PAGE_WIDTH))
    caption = "Every basis along one line through the regions where the last one is strongest."
    return (picture(path, caption),)


def _write_numbers(volumes: np.ndarray, case: Case, plane: str, path: Path) -> None:
    """Write the numbers of a figure of slices: the range of each basis in the slice, and its error."""
    axis = PLANES.index(plane)
    cut = volumes.take(case.grid.shape[axis] // 2, axis=axis + 1)
    table = {"basis": np.arange(len(cut)), "lowest_per_mm": cut.min((1, 2)), "highest_per_mm": cut.max((1, 2))}
    if case.true is not None:
        error = cut - case.true.take(case.grid.shape[axis] // 2, axis=axis + 1)
        table |= {"bias_per_mm": error.mean((1, 2)), "rmse_per_mm": np.sqrt((error**2).mean((1, 2)))}
    write_csv(path, table)
