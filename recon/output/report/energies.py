"""Energies of a scan: photons, channels, K edges, and basis functions, raw and conditioned."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from phantomgen.dataset.spectral_model import Spectra
from phantomgen.display.figures.dataset_energies import spectrum
from phantomgen.display.figures.style import BASIS_LINES, PAGE_WIDTH, figure_file, write_csv
from phantomgen.display.html import picture
from recon.output.report.case import Case, Parts
from spectra.basis.basis import pretty
from spectra.basis.conditioning import conditioning_of
from spectra.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def parts(case: Case) -> Parts:
    """Draw spectrum, channels and bases of the dataset.

    Parameters
    ----------
    case : runs of the report

    Returns
    -------
    parts of the page

    Raises
    ------
    LeftOut
        When the dataset was not found.
    """
    s = case.needs_dataset().spectra
    path = case.path("spectrum")
    case.drawn(path, spectrum(s, path, PAGE_WIDTH))
    found = [picture(path, "Incident photons and the part that each channel counts, above the raw basis functions.")]
    path = case.path("conditioned_basis")
    conditioned = conditioned_basis(s, path)
    if conditioned is not None:
        caption = (
            "The same functions made orthonormal over all detected photons, as solvers use them. Functions that are "
            "nearly equal above have coefficients whose noise is strongly correlated."
        )
        found.append(picture(case.drawn(path, conditioned), caption))
    return tuple(found)


def conditioned_basis(spectra: Spectra, path: Path | None = None) -> "Figure | None":
    """Draw the basis functions after whitening over the detected spectrum, with a CSV.

    Parameters
    ----------
    spectra : spectra of the dataset
    path : figure to write, with its CSV where it has one; None for no file

    Returns
    -------
    the figure; None where the basis functions cannot be distinguished
    """
    seen = spectra.weights.sum(axis=0)
    kept = seen > 0
    try:
        columns = conditioning_of(spectra.basis_values, seen).columns(spectra.basis_values)
    except InputError:
        return None
    energy = spectra.energy[kept]
    write_csv(path, {"energy_keV": energy, **dict(zip(spectra.basis.names, columns[:, kept], strict=True))})
    with figure_file(path, (PAGE_WIDTH, 2.9)) as figure:
        ax = figure.subplots()
        for i, (name, row) in enumerate(zip(spectra.basis.names, columns[:, kept], strict=True)):
            colour, dashes = BASIS_LINES[i % len(BASIS_LINES)]
            marker = "o" if len(energy) == 1 else None
            ax.plot(energy, row, color=colour, linestyle=dashes, marker=marker, label=pretty(name))
        limit = float(np.quantile(np.abs(columns[:, kept]), 0.995)) * 1.15
        ax.axhline(0, color="0.6", linewidth=0.7, zorder=0)
        ax.set(xlabel="energy [keV]", ylabel="conditioned functions [no unit]", ylim=(-limit, limit))
        figure.legend(*ax.get_legend_handles_labels(), loc="outside upper right", ncols=3)
    return figure
