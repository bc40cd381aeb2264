"""Figures of arrays, as figures of matplotlib; each is written, too, where a path is given.

`recon.report_figures(run)` draws all figures of a report. Names are imported when they are first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from recon.figures.run_figures import basis_slices, convergence, profiles, residuals, spectrum

__all__ = ["basis_slices", "convergence", "profiles", "residuals", "spectrum"]


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used."""
    if name not in __all__:
        raise AttributeError(f"module 'recon.figures' has no attribute {name!r}")
    return getattr(import_module("recon.figures.run_figures"), name)


def __dir__() -> list[str]:
    """Public names."""
    return __all__
