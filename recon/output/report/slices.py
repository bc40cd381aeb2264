"""Figures of volumes: three planes, profiles, and a virtual monoenergetic image."""

from pathlib import Path

import numpy as np
from jaxtyping import Float, Real

from phantomgen.display.figures.style import PAGE_WIDTH, figure_file, write_csv
from phantomgen.display.html import Part, picture
from phantomgen.geometry.voxel_grid import Grid
from recon.figures import run_figures as figures
from recon.output.report.case import Case, LeftOut, Parts
from spectra.basis.basis import Basis
from spectra.materials.material import Material

PLANES = ("axial", "coronal", "sagittal")
MONO = 70.0  # keV; energy of the virtual monoenergetic image, the reference energy of the bases
_WATER = Material("water", composition="H2O", density=1.0)


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
            figures.basis_slices(volumes, case.true, case.names, case.grid, path, plane, PAGE_WIDTH)
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
    path = figures.profiles(results, case.true, case.names, case.grid, case.path("profiles"), line, PAGE_WIDTH)
    caption = "Every basis along one line through the regions where the last one is strongest."
    return (picture(path, caption),)


def mono_parts(case: Case) -> Parts:
    """Draw a virtual monoenergetic image of every run.

    Parameters
    ----------
    case : runs of the report

    Returns
    -------
    parts of the page

    Raises
    ------
    LeftOut
        When the dataset was not found, or has other bases than the runs.
    """
    basis = case.needs_dataset().spectra.basis
    if not set(case.names) <= set(basis.names):
        raise LeftOut("the dataset states other bases than the reconstruction")
    found: list[Part] = []
    for i, run in enumerate(case.runs):
        path = case.path("mono" if i == 0 else f"mono_{i}")
        result = hounsfield(case.volumes(run), basis, case.names)
        true = None if case.true is None else hounsfield(case.true, basis, case.names)
        mono_figure(result, true, case.grid, path)
        caption = f"{case.who(run)}Attenuation at {MONO:g} keV, middle axial slice, in HU: water is 0, air −1000."
        found.append(picture(path, caption))
    return tuple(found)


def hounsfield(
    volumes: Real[np.ndarray, "basis z y x"], basis: Basis, names: tuple[str, ...], energy: float = MONO
) -> Float[np.ndarray, "z y x"]:
    """Compute a virtual monoenergetic image, 1000 (mu - mu_water) / mu_water.

    Parameters
    ----------
    volumes : coefficients of `names` [1/mm]
    basis : basis functions of the dataset
    names : names of the bases of `volumes`; bases of the dataset that are not among them count as 0
    energy : energy [keV]

    Returns
    -------
    CT numbers [HU]
    """
    values = dict(zip(basis.names, basis.evaluate(np.array([energy]))[:, 0], strict=True))
    water = _WATER.attenuation(np.array([energy]))[0]
    mu = np.tensordot(np.array([values[name] for name in names]), np.asarray(volumes, dtype=np.float64), axes=1)
    return 1000 * (mu / water - 1)


def mono_figure(
    result: Float[np.ndarray, "z y x"], truth: Float[np.ndarray, "z y x"] | None, grid: Grid, path: Path
) -> Path:
    """Draw the middle axial slice: truth, result and difference, or the result alone, with the central row as CSV.

    Parameters
    ----------
    result, truth : CT numbers [HU]; None where there is no truth
    grid : grid of the volumes
    path : figure to write

    Returns
    -------
    path
    """
    middle = grid.shape[0] // 2
    images = {"result": result[middle]} if truth is None else {"truth": truth[middle], "result": result[middle]}
    reference = result if truth is None else truth
    low, high = -1000.0, float(np.ceil(np.quantile(reference, 0.999) / 100 + 1) * 100)
    extent = (*figures.borders(grid, "x"), *figures.borders(grid, "y"))
    with figure_file(path, (PAGE_WIDTH, 2.3 if truth is not None else 3.4)) as figure:
        axes = figure.subplots(1, len(images) + (truth is not None), sharey=True, squeeze=False)[0]
        for ax, (title, image) in zip(axes, images.items(), strict=False):
            gray = ax.imshow(image, cmap="gray", vmin=low, vmax=high, extent=extent, origin="lower")
            ax.set_title(title)
        shared = list(axes[: len(images)])
        figure.colorbar(gray, ax=shared, location="bottom", extend="max", aspect=30, shrink=0.9).set_label("HU")
        if truth is not None:
            error = images["result"] - images["truth"]
            limit = max(float(np.quantile(np.abs(error), 0.99)), 1.0)
            shown = axes[-1].imshow(error, cmap="RdBu_r", vmin=-limit, vmax=limit, extent=extent, origin="lower")
            axes[-1].set_title("result − truth")
            figure.colorbar(shown, ax=axes[-1], location="bottom", extend="both", aspect=15).set_label("HU")
        axes[0].set_ylabel("y [mm]")
        for ax in axes:
            ax.spines[:].set_visible(True)
            ax.set_xlabel("x [mm]")
    row = grid.shape[1] // 2
    write_csv(path, {"x_mm": grid.axis("x"), **{f"{name}_HU": image[row] for name, image in images.items()}})
    return path


def _write_numbers(volumes: np.ndarray, case: Case, plane: str, path: Path) -> None:
    """Write the numbers of a figure of slices: the range of each basis in the slice, and its error."""
    axis = PLANES.index(plane)
    cut = volumes.take(case.grid.shape[axis] // 2, axis=axis + 1)
    table = {"basis": np.arange(len(cut)), "lowest_per_mm": cut.min((1, 2)), "highest_per_mm": cut.max((1, 2))}
    if case.true is not None:
        error = cut - case.true.take(case.grid.shape[axis] // 2, axis=axis + 1)
        table |= {"bias_per_mm": error.mean((1, 2)), "rmse_per_mm": np.sqrt((error**2).mean((1, 2)))}
    write_csv(path, table)
