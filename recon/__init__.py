"""Reconstruction of basis volumes from spectral-CT counts, by Gaussians with a physical forward model.

>>> import recon
>>> recon.Recipe().stages
(Stage(pixel=0.5, sweeps=1.0),)

`recon.fit(dataset)` gives a fit that renders, scores and saves itself, `recon.segment(fit)` finds its materials,
`recon.readout(fit, "hu", energy=70)` gives CT numbers, concentrations, electron density and atomic numbers,
`recon.estimate_uncertainty(run, dataset)` and `recon.deviation(run, "hu", energy=70)` give standard deviations,
`recon.score(volume, dataset, ...)` scores a volume of any program, and
`recon.reconstruct(dataset, recipe)` is the computation alone. Names are imported when they are first used, so that
importing the package takes no time.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from recon.api import Fit, deviation, estimate_uncertainty, fit, readout, score, segment
    from recon.gaussians.model import Gaussians
    from recon.gaussians.processes import Resources
    from recon.gaussians.recipe import Recipe, Stage
    from recon.gaussians.reconstruct import Reconstruction, reconstruct
    from recon.readouts.readouts import Readouts
    from recon.voxel.filtered.fdk import fdk

__all__ = [
    "Fit",
    "Gaussians",
    "Readouts",
    "Recipe",
    "Reconstruction",
    "Resources",
    "Stage",
    "deviation",
    "estimate_uncertainty",
    "fdk",
    "fit",
    "readout",
    "reconstruct",
    "score",
    "segment",
]

_HOMES = {
    "Fit": "api",
    "Gaussians": "gaussians.model",
    "Readouts": "readouts.readouts",
    "Recipe": "gaussians.recipe",
    "Reconstruction": "gaussians.reconstruct",
    "Resources": "gaussians.processes",
    "Stage": "gaussians.recipe",
    "deviation": "api",
    "estimate_uncertainty": "api",
    "fdk": "voxel.filtered.fdk",
    "fit": "api",
    "readout": "api",
    "reconstruct": "gaussians.reconstruct",
    "score": "api",
    "segment": "api",
}


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used."""
    if name not in _HOMES:
        raise AttributeError(f"module 'recon' has no attribute {name!r}")
    return getattr(import_module(f"recon.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    """Public names."""
    return __all__
