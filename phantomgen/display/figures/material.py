"""Figure of a material: mu(E) from tables, its fit in the basis, and the error between the two."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from phantomgen.analysis.materials import HIGHEST, LOWEST, MaterialFit
from phantomgen.display.figures.style import BLACK, GRID, LINES, RED, check_picture, figure_file

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_TICKS = (20, 30, 40, 50, 60, 80, 100, 140)
_BESIDE_EDGE = 0.01  # keV, so that edges are vertical


def write_figure(fit: MaterialFit, path: Path | str) -> Path:
    """Draw mu(E), its parts and the fit on logarithmic axes, and the relative error below, as PNG, PDF or SVG.

    Parameters
    ----------
    fit : material and its fit
    path : the picture

    Returns
    -------
    path of the picture
    """
    path = Path(path)
    check_picture(path)
    with figure_file(path, (6.5, 5.5)) as figure:
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
        _draw_curves(upper, fit)
        _draw_errors(lower, fit)
    return path


def _draw_curves(axes: "Axes", fit: MaterialFit) -> None:
    """Exact curve, fit, and the contribution of every basis function."""
    edges = np.array(fit.basis.breaks)
    energy = np.sort(np.concatenate([fit.energy, edges - _BESIDE_EDGE, edges]))
    values = fit.basis.evaluate(energy)
    exact, fitted = fit.material.attenuation(energy), fit.coefficients @ values
    axes.loglog(energy, exact, color=BLACK, linewidth=2.2, label="tables")
    axes.loglog(energy, fitted, color=RED, linewidth=1.2, linestyle="--", label="fit")
    for i, (name, coefficient) in enumerate(zip(fit.basis.names, fit.coefficients, strict=True)):
        if coefficient > 0:
            colour, dashes = LINES[i % len(LINES)]
            axes.loglog(energy, coefficient * values[i], color=colour, linestyle=dashes, linewidth=1.2, label=name)
    axes.set_ylim(exact.min() / 30, exact.max() * 1.5)
    axes.set_ylabel("attenuation [1/mm]")
    axes.set_title(f"{fit.material.name}, {fit.material.density:.4g} g/cm$^3$")
    axes.legend(ncols=2)
    axes.grid(which="both", color=GRID, linewidth=0.5)


def _draw_errors(axes: "Axes", fit: MaterialFit) -> None:
    """Relative error of the fit."""
    axes.axhline(0.0, color="0.6", linewidth=0.8)
    axes.plot(fit.energy, 100 * fit.errors, color=RED, linewidth=1.2)
    axes.set_xscale("log")
    axes.set_xlim(LOWEST, HIGHEST)
    axes.set_xticks(_TICKS, [str(tick) for tick in _TICKS])
    axes.minorticks_off()
    axes.set_xlabel("energy [keV]")
    axes.set_ylabel("error of the fit [%]")
    limit = max(0.1, 110 * float(np.abs(fit.errors).max()))
    axes.set_ylim(-limit, limit)
    axes.grid(color=GRID, linewidth=0.5)
