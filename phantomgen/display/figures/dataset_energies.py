"""Figure of the energies of a dataset: source, counts of the channels, and basis functions."""

from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from phantomgen.dataset.spectral_model import Spectra
from phantomgen.display.figures.style import BASIS_LINES, WIDTH, channel_colours, figure_file, write_csv
from spectra.basis.basis import pretty

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def spectrum(spectra: Spectra, path: Path | None = None, width: float = WIDTH) -> "Figure":
    """Draw source and counts of each channel, per keV, above the basis functions; with a CSV of all bins.

    Parameters
    ----------
    spectra : energies of the dataset
    path : figure to write, with its CSV where it has one; None for no file
    width : of the picture [inch]

    Returns
    -------
    the figure
    """
    energy, edges, source = spectra.energy, spectra.edges, spectra.source
    basis_names, basis_values, counted = spectra.basis.names, spectra.basis_values, spectra.weights
    columns = {"energy_keV": energy, "bin_low_keV": edges[:-1], "bin_high_keV": edges[1:], "source": source}
    columns |= {f"{name}_counts": row for name, row in zip(spectra.channels, counted, strict=True)}
    columns |= {f"basis_{name}": row for name, row in zip(basis_names, basis_values, strict=True)}
    write_csv(path, columns)
    with figure_file(path, (width, 4.6)) as figure:
        top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=[1.25, 1])
        display = _display_bins(edges, spectra.response)
        colours = channel_colours(len(spectra.channels))
        for name, row, colour in zip(spectra.channels, counted, colours, strict=True):
            top.stairs(
                _per_keV(row, edges, display), display, fill=True, color=colour, alpha=0.75, linewidth=0, label=name
            )
        top.stairs(_per_keV(source, edges, display), display, color="black", linewidth=0.9, label="incident")
        top.set_ylabel("photons per pixel, view and keV")
        top.set_ylim(bottom=0)
        for i, (name, row) in enumerate(zip(basis_names, basis_values, strict=True)):
            colour, dashes = BASIS_LINES[i % len(BASIS_LINES)]
            visible = np.maximum(row, 1e-9)  # a step then falls off the logarithmic axis
            marker = "o" if len(energy) == 1 else None
            bottom.plot(energy, visible, color=colour, linestyle=dashes, marker=marker, label=pretty(name))
        lowest = basis_values[basis_values > 0].min(initial=1.0)
        scale = "log" if len(energy) > 1 else "linear"
        bottom.set(yscale=scale, ylim=(lowest / 1.5, basis_values.max() * 1.5), xlabel="energy [keV]")
        bottom.set_ylabel("basis functions [no unit]")
        for edge in spectra.basis.breaks:
            for ax in (top, bottom):
                ax.axvline(edge, color="0.35", linewidth=0.7, linestyle=(0, (2, 2)), zorder=0)
            top.annotate(
                f"K edge {edge:g} keV", (edge, 1), xycoords=("data", "axes fraction"), ha="center", va="bottom"
            )
        top.set_xlim(*_shown_range(edges))
        top.legend(loc="upper right")
        bottom.legend(loc="upper right")
        bottom.yaxis.set_major_formatter("{x:g}")
        figure.align_ylabels()
    return figure


def _display_bins(edges: np.ndarray, response: np.ndarray) -> np.ndarray:
    """Borders of bins of about 1 keV, in which lines get the height of their photons; channels end on borders [keV]."""
    low, high = _shown_range(edges)
    ends = edges[1:-1][np.any((response[:, 1:] > 0) != (response[:, :-1] > 0), axis=0)]
    stops = np.unique([low, *ends, high])
    parts = [np.linspace(a, b, max(round(b - a), 1), endpoint=False) for a, b in pairwise(stops)]
    return np.concatenate([*parts, [high]])


def _per_keV(photons: np.ndarray, edges: np.ndarray, display: np.ndarray) -> np.ndarray:
    """Photons per keV in the bins with borders `display`."""
    total = np.interp(display, edges, np.concatenate([[0.0], np.cumsum(photons)]))
    return np.diff(total) / np.diff(display)


def _shown_range(edges: np.ndarray) -> tuple[float, float]:
    """Energies to show [keV]: all, widened to 10 keV for a monochromatic source."""
    middle, half = (edges[0] + edges[-1]) / 2, (edges[-1] - edges[0]) / 2
    return (float(edges[0]), float(edges[-1])) if half >= 5 else (middle - 5.5, middle + 5.5)
