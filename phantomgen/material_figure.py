"""A picture of a material: mu(E) from tables, its fit in the basis, and the error between the two."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from phantomgen.material_info import HIGHEST, LOWEST, MaterialFit
from spectra.errors import InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_TICKS = (20, 30, 40, 50, 60, 80, 100, 140)
_LINES = (("#0072B2", (0, (4, 2))), ("#E69F00", (0, (1, 1))), ("#009E73", (0, (5, 1, 1, 1))), ("#CC79A7", (0, (2, 2))))
_BESIDE_EDGE = 0.01  # keV, so that edges stand upright
_STYLE = {"font.size": 9, "axes.spines.top": False, "axes.spines.right": False, "legend.frameon": False}


def write_figure(fit: MaterialFit, path: Path | str) -> Path:
    """Write mu(E), its parts and the fit on logarithmic axes, and the relative error below, as PNG, PDF or SVG."""
    path = Path(path)
    check_figure(path)
    from matplotlib import rc_context  # noqa: PLC0415 - half a second
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415
    from matplotlib.figure import Figure  # noqa: PLC0415

    with rc_context(_STYLE):  # pyright: ignore[reportArgumentType]
        figure = Figure(figsize=(6.5, 5.5), dpi=150, layout="constrained")
        FigureCanvasAgg(figure)
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
        _draw_curves(upper, fit)
        _draw_errors(lower, fit)
        figure.savefig(path)
    return path


def check_figure(path: Path) -> None:
    """Refuse a picture that cannot be written."""
    if path.suffix not in {".png", ".pdf", ".svg"}:
        raise InputError(f"a picture ends in .png, .pdf or .svg, got {path.name!r}")
    if not path.absolute().parent.is_dir():
        raise InputError(f"the folder {path.parent} for the picture {path.name} does not exist")


def _draw_curves(axes: "Axes", fit: MaterialFit) -> None:
    """Exact curve, fit, and the contribution of every basis function."""
    edges = np.array(fit.basis.breaks)
    energy = np.sort(np.concatenate([fit.energy, edges - _BESIDE_EDGE, edges]))
    values = fit.basis.evaluate(energy)
    exact, fitted = fit.material.attenuation(energy), fit.coefficients @ values
    axes.loglog(energy, exact, color="black", linewidth=2.2, label="tables")
    axes.loglog(energy, fitted, color="#D55E00", linewidth=1.2, linestyle="--", label="fit")
    for i, (name, coefficient) in enumerate(zip(fit.basis.names, fit.coefficients, strict=True)):
        if coefficient > 0:
            colour, dashes = _LINES[i % len(_LINES)]
            axes.loglog(energy, coefficient * values[i], color=colour, linestyle=dashes, linewidth=1.2, label=name)
    axes.set_ylim(exact.min() / 30, exact.max() * 1.5)
    axes.set_ylabel("attenuation [1/mm]")
    axes.set_title(f"{fit.material.name}, {fit.material.density:.4g} g/cm$^3$")
    axes.legend(ncols=2)
    axes.grid(which="both", color="0.9", linewidth=0.5)


def _draw_errors(axes: "Axes", fit: MaterialFit) -> None:
    """Relative error of the fit."""
    axes.axhline(0.0, color="0.6", linewidth=0.8)
    axes.plot(fit.energy, 100 * fit.errors, color="#D55E00", linewidth=1.2)
    axes.set_xscale("log")
    axes.set_xlim(LOWEST, HIGHEST)
    axes.set_xticks(_TICKS, [str(tick) for tick in _TICKS])
    axes.minorticks_off()
    axes.set_xlabel("energy [keV]")
    axes.set_ylabel("error of the fit [%]")
    limit = max(0.1, 110 * float(np.abs(fit.errors).max()))
    axes.set_ylim(-limit, limit)
    axes.grid(color="0.9", linewidth=0.5)
