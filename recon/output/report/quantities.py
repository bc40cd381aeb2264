"""Physical quantities of a run: CT numbers, contrast agents, electron density and effective atomic number."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from phantomgen.display.figures.style import PAGE_WIDTH, figure_file, write_csv
from phantomgen.display.html import Part, Table, picture
from phantomgen.geometry.voxel_grid import Grid
from recon.figures import run_figures as figures
from recon.output.report.case import Case, LeftOut, Parts, number
from recon.readouts.quantity import NAMES, Quantity, in_pieces, quantity
from recon.readouts.readouts import Readouts
from recon.readouts.spectrum import detected_spectrum
from recon.runs.run_folder import SCAN, open_scan
from spectra.basis.basis import Basis
from spectra.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_TITLES = {
    "HU": "[HU]",
    "1/mm": "[1/mm]",
    "mg/ml": "[mg/ml]",
    "1": "",
}


@dataclass(frozen=True, eq=False)
class Maps:
    """One quantity of a run, and of the truth.

    Parameters
    ----------
    chosen : the quantity
    result : of the run
    true : of the truth; None where it is not known
    """

    chosen: Quantity
    result: Float[np.ndarray, "z y x"]
    true: Float[np.ndarray, "z y x"] | None


def parts(case: Case) -> Parts:
    """Draw the quantities that the bases show, and list their means per material.

    Parameters
    ----------
    case : runs of the report

    Returns
    -------
    parts of the page

    Raises
    ------
    LeftOut
        When no run folder states its spectrum.
    """
    found: list[Part] = []
    for i, run in enumerate(case.runs):
        conversion = _conversion(case, run.folder)
        result = case.volumes(run)
        maps = [
            Maps(q, in_pieces(q, result), None if case.true is None else in_pieces(q, case.true))
            for q in shown_quantities(conversion)
        ]
        for each in maps:
            path = case.path(f"{each.chosen.name}{'' if i == 0 else f'_{i}'}")
            case.drawn(path, slice_figure(each, case.grid, path))
            unit = f" {_TITLES[each.chosen.unit]}".rstrip()
            about = each.chosen.about
            found.append(picture(path, f"{case.who(run)}{about[0].upper()}{about[1:]}{unit}, middle axial slice."))
        if case.true is not None:
            found.append(_table(case, maps, case.label(run), i))
    return tuple(found)


def shown_quantities(conversion: Readouts) -> list[Quantity]:
    """Return the quantities that a basis shows.

    Parameters
    ----------
    conversion : of the basis

    Returns
    -------
    CT numbers, those without contrast agents, concentrations, electron density, atomic number
    """
    found = []
    for name in (*NAMES[1:3], *conversion.agents, *NAMES[3:]):
        try:
            found.append(quantity(conversion, name))
        except InputError:  # the basis cannot show it
            continue
    return found


def slice_figure(maps: Maps, grid: Grid, path: Path | None = None) -> "Figure":
    """Draw the middle axial slice: truth, result and difference, or the result alone, with the central row as CSV.

    Parameters
    ----------
    maps : quantity of result and truth
    grid : grid of the volumes
    path : figure to write, with its CSV where it has one; None for no file

    Returns
    -------
    the figure
    """
    middle, unit = grid.shape[0] // 2, maps.chosen.unit
    images = {"result": maps.result[middle]}
    if maps.true is not None:
        images = {"truth": maps.true[middle]} | images
    low, high = _range(maps)
    extent = (*figures.borders(grid, "x"), *figures.borders(grid, "y"))
    label = "" if unit == "1" else unit
    with figure_file(path, (PAGE_WIDTH, 2.3 if maps.true is not None else 3.4)) as figure:
        axes = figure.subplots(1, len(images) + (maps.true is not None), sharey=True, squeeze=False)[0]
        for ax, (title, image) in zip(axes, images.items(), strict=False):
            gray = ax.imshow(image, cmap="gray", vmin=low, vmax=high, extent=extent, origin="lower")
            ax.set_title(title)
        shared = list(axes[: len(images)])
        figure.colorbar(gray, ax=shared, location="bottom", extend="max", aspect=30, shrink=0.9).set_label(label)
        if maps.true is not None:
            error = images["result"] - images["truth"]
            known = np.abs(error[np.isfinite(error)])
            limit = max(float(np.quantile(known, 0.99)) if known.size else 0.0, 1e-3 * (high - low))
            shown = axes[-1].imshow(error, cmap="RdBu_r", vmin=-limit, vmax=limit, extent=extent, origin="lower")
            axes[-1].set_title("result − truth")
            bar = figure.colorbar(shown, ax=axes[-1], location="bottom", extend="both", aspect=15)
            bar.set_label(label)
            bar.ax.tick_params(labelsize="small")
        axes[0].set_ylabel("y [mm]")
        for ax in axes:
            ax.spines[:].set_visible(True)
            ax.set_xlabel("x [mm]")
    row = grid.shape[1] // 2
    suffix = "" if unit == "1" else "_" + unit.replace("/", "_per_")
    write_csv(path, {"x_mm": grid.axis("x"), **{f"{name}{suffix}": image[row] for name, image in images.items()}})
    return figure


def _range(maps: Maps) -> tuple[float, float]:
    """Lowest and highest value that is drawn."""
    reference = maps.result if maps.true is None else maps.true
    known = reference[np.isfinite(reference)]
    top = float(np.quantile(known, 0.999)) if known.size else 1.0
    if maps.chosen.unit == "HU":
        return -1000.0, float(np.ceil(top / 100 + 1) * 100)
    return 0.0, max(1.1 * top, 1e-6)


def _conversion(case: Case, folder: Path) -> Readouts:
    """Conversion for the bases of the report."""
    if not (folder / SCAN).is_file():
        raise LeftOut(f"{folder} has no {SCAN}, which older versions did not write")
    scan = open_scan(folder)
    if not set(case.names) <= set(scan.basis.names):
        raise LeftOut("the scan states other bases than the reconstruction")
    spectrum = detected_spectrum(scan.basis, scan.transmission)
    own = tuple(f for name in case.names for f in scan.basis.functions if f.name == name)
    return Readouts.of(Basis(own, scan.basis.reference_energy), *spectrum)


def _table(case: Case, maps: Sequence[Maps], label: str, run: int) -> Table:
    """Means of the quantities inside of each material: of the result, and of the truth in brackets."""
    truth = case.needs_truth()
    header = ("material", *(f"{m.chosen.name.replace('_', ' ')} {_TITLES[m.chosen.unit]}".rstrip() for m in maps))
    rows = []
    for i, name in enumerate(truth.material_names):
        inside = truth.fractions[i] == np.iinfo(truth.fractions.dtype).max
        if not inside.any():
            continue
        cells = [f"{_mean(m.result, inside, m.chosen)} ({_mean(m.true, inside, m.chosen)})" for m in maps]
        rows.append((name, *cells))
    caption = (
        f"Means over the voxels that a material fills, of the {label}, with those of the truth in brackets. 0 HU is "
        "water as the basis describes it."
    )
    return Table(header, tuple(rows), caption, "quantities" if run == 0 else f"quantities_{run}")


def _mean(values: Float[np.ndarray, "z y x"] | None, inside: np.ndarray, chosen: Quantity) -> str:
    """Mean of known values as text."""
    known = np.array([]) if values is None else values[inside]
    known = known[np.isfinite(known)]
    return number(float(known.mean()) if known.size else None, {"HU": ".0f", "1": ".3f"}.get(chosen.unit, ".2f"))
