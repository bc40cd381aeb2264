"""Figure of the energies of a scan: source, counts of the channels, basis functions, and K edges."""

from math import floor
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from phantomgen.display.figures.style import GRID, LINES, RED, channel_colours, check_picture, figure_file
from phantomgen.scene.scan import Scan
from spectra.basis.basis import pretty
from spectra.elements.attenuation import edge_energy, k_edges, mass_fractions, symbol
from spectra.energy.grid import Energies

if TYPE_CHECKING:
    from matplotlib.axes import Axes

BIN = 0.5  # keV, in which photons are drawn: lines stand out as bins, and areas stay photons
_BESIDE_EDGE = 0.01  # keV, so that edges are vertical
_UNSEEN = 1e-4  # part of the photons that lies to the left of the picture


def write_figure(scan: Scan, path: Path | str) -> Path:
    """Draw photons of the source, counts of the channels and basis functions over energy, as PNG, PDF or SVG.

    Parameters
    ----------
    scan : the scan
    path : the picture

    Returns
    -------
    path of the picture
    """
    path = Path(path)
    check_picture(path)
    low = _lowest(scan)
    grid = _bins(scan, low)
    with figure_file(path, (6.5, 7.0)) as figure:
        panels = figure.subplots(3, 1, sharex=True, height_ratios=(3, 3, 2.5))
        _draw_source(panels[0], scan, grid)
        _draw_channels(panels[1], scan, grid)
        _draw_basis(panels[2], scan, low)
        draw_edges(list(panels), scan, low)
        panels[0].set_xlim(low, _highest(scan))
        panels[0].set_title(f"{scan.name}: {scan.source.photons:,.0f} photons per pixel and view")
        panels[2].set_xlabel("energy [keV]")
        for axes in panels:
            axes.grid(color=GRID, linewidth=0.5)
            axes.set_axisbelow(True)
    return path


def scene_edges(scan: Scan, low: float) -> dict[str, float]:
    """Return the K edges of the materials and of the basis from `low` to the highest energy.

    Parameters
    ----------
    scan : the scan
    low : lowest energy [keV]

    Returns
    -------
    energies [keV] by element or name
    """
    compositions = [m.composition for m in scan.scene.materials if m.composition is not None]
    elements = {symbol(number) for c in compositions for number, _ in mass_fractions(c)}
    edges = {e: edge_energy(e) for e in elements if k_edges(e, low, scan.source.maximum)}
    for function in scan.basis.functions:
        edge = function.edge_energy
        if edge is not None and low < edge < scan.source.maximum and edge not in edges.values():
            edges[function.element or "K edge"] = edge
    return dict(sorted(edges.items(), key=lambda item: item[1]))


def _lowest(scan: Scan) -> float:
    """Left end of the picture, a multiple of 5 keV: few photons and no threshold lie to the left of it."""
    edges = np.arange(0.0, scan.source.maximum + 1.0)
    photons = scan.source.photons_in(np.append(edges, edges[-1] + 1.0))[0]
    first = edges[np.searchsorted(np.cumsum(photons), _UNSEEN * photons.sum())]
    return max(5.0, 5.0 * floor(min(first, scan.detector.channels[0].lower) / 5.0))


def _highest(scan: Scan) -> float:
    """Right end of the picture."""
    return scan.source.maximum + (5.0 if scan.source.is_monochromatic else 1.0)


def _bins(scan: Scan, low: float) -> Energies:
    """Bins of about `BIN` that thresholds do not cut."""
    high = _highest(scan)
    return Energies.snapped(low, high, round((high - low) / BIN), scan.detector.breaks)


def _draw_source(axes: "Axes", scan: Scan, grid: Energies) -> None:
    """Photons per keV."""
    photons = scan.source.photons_in(grid.edges)[0] / grid.widths
    axes.stairs(photons, grid.edges, fill=True, color="0.8")
    axes.stairs(photons, grid.edges, color="0.25", linewidth=0.9)
    axes.set_ylabel("photons per keV")
    axes.set_ylim(0.0, 1.12 * photons.max())


def _draw_channels(axes: "Axes", scan: Scan, grid: Energies) -> None:
    """Counts per keV of every channel, or their energy where the detector sums that up."""
    counted = scan.detector.units == "counts"
    photons, mean = scan.source.photons_in(grid.edges)
    counts = scan.detector.response(Energies(grid.edges, mean)) * photons
    colours = channel_colours(len(scan.detector))
    for channel, colour, row in zip(scan.detector.channels, colours, counts, strict=True):
        share = row.sum() / scan.source.photons
        amount = f"{share:.0%}" if counted else f"{share:.3g} {scan.detector.units}"
        label = f"{channel.name}, {channel.lower:g} .. {channel.upper:g} keV: {amount}"
        seen = np.flatnonzero(row > 0)
        if len(seen):
            part = slice(seen[0], seen[-1] + 1)
            edges = grid.edges[seen[0] : seen[-1] + 2]
            axes.stairs((row / grid.widths)[part], edges, fill=True, color=colour, alpha=0.35)
            axes.stairs((row / grid.widths)[part], edges, color=colour, linewidth=0.9, label=label)
    axes.set_ylabel("counts per keV of energy" if counted else f"{scan.detector.units} per keV of energy")
    axes.set_ylim(0.0, 1.12 * float((counts / grid.widths).max()))
    title = "part of the photons that is counted" if counted else "signal per photon of the source"
    axes.legend(title=title, fontsize=8, title_fontsize=8, loc="upper right")


def _draw_basis(axes: "Axes", scan: Scan, low: float) -> None:
    """Basis functions, raw."""
    edges = np.array(scan.basis.breaks)
    energy = np.sort(np.concatenate([np.linspace(low, _highest(scan), 600), edges - _BESIDE_EDGE, edges]))
    for i, (name, values) in enumerate(zip(scan.basis.names, scan.basis.evaluate(energy), strict=True)):
        colour, dashes = (RED, "-") if i == 0 else LINES[(i - 1) % len(LINES)]
        axes.semilogy(energy, np.where(values > 0, values, np.nan), color=colour, linestyle=dashes, label=pretty(name))
    axes.set_ylim(0.05, 50.0)
    axes.set_ylabel("basis functions [1]")
    axes.legend(fontsize=8, ncols=2, loc="upper right")


def draw_edges(panels: list["Axes"], scan: Scan, low: float) -> None:
    """Draw the K edges through all panels, with their names above the first one.

    Parameters
    ----------
    panels : axes, the upper one first
    scan : the scan
    low : lowest energy [keV]
    """
    for name, edge in scene_edges(scan, low).items():
        for axes in panels:
            axes.axvline(edge, color="0.35", linewidth=0.8, linestyle=(0, (2, 2)), zorder=1.5)
        axes = panels[0]
        axes.annotate(
            f"{name}\n{edge:.4g}", (edge, 1.0), (3, -2), xycoords=axes.get_xaxis_transform(),
            textcoords="offset points", fontsize=7.5, va="top", color="0.25",
        )  # fmt: skip
