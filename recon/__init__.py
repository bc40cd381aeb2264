"""Reconstruction of basis volumes from spectral-CT counts, by Gaussians with a physical forward model.

>>> import recon
>>> recon.Recipe().stages
(Stage(pixel=0.5, sweeps=1.0),)

`recon.fit(dataset)` gives a fit that renders, scores and saves itself, `recon.segment(fit)` finds its materials,
`recon.readout(fit, "hu", energy=70)` gives CT numbers, concentrations, electron density and atomic numbers,
`recon.estimate_uncertainty(run, dataset)` and `recon.deviation(run, "hu", energy=70)` give standard deviations,
`recon.estimate_detectability(run, dataset, insert)` says how well an insert is detected,
`recon.align(scan, out)` corrects the stated panel of a scan,
`recon.score(volume, dataset, ...)` scores a volume of any program, `recon.score_truth(truth, volumes)` basis volumes on
the grid of the truth, `recon.quality` measures noise and resolution, and
`recon.reconstruct(dataset, recipe)` is the computation alone. Names are imported when they are first used, so that
importing the package takes no time.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from recon.alignment.interface import align
    from recon.api import Fit, fit, readout, report_figures, score, segment
    from recon.callbacks import EarlyStop, ProgressBar
    from recon.evaluation.scoring import score_truth
    from recon.gaussians.model import Gaussians
    from recon.gaussians.processes import Resources
    from recon.gaussians.recipe import Recipe, Stage
    from recon.gaussians.reconstruct import Reconstruction, reconstruct
    from recon.noise import deviation, estimate_detectability, estimate_uncertainty
    from recon.readouts.readouts import Readouts
    from recon.voxel.filtered.fdk import fdk

__all__ = [
    "EarlyStop",
    "Fit",
    "Gaussians",
    "ProgressBar",
    "Readouts",
    "Recipe",
    "Reconstruction",
    "Resources",
    "Stage",
    "align",
    "deviation",
    "estimate_detectability",
    "estimate_uncertainty",
    "fdk",
    "fit",
    "readout",
    "reconstruct",
    "report_figures",
    "score",
    "score_truth",
    "segment",
]

_HOMES = {
    "EarlyStop": "callbacks",
    "Fit": "api",
    "Gaussians": "gaussians.model",
    "ProgressBar": "callbacks",
    "Readouts": "readouts.readouts",
    "Recipe": "gaussians.recipe",
    "Reconstruction": "gaussians.reconstruct",
    "Resources": "gaussians.processes",
    "Stage": "gaussians.recipe",
    "align": "alignment.interface",
    "deviation": "noise",
    "estimate_detectability": "noise",
    "estimate_uncertainty": "noise",
    "fdk": "voxel.filtered.fdk",
    "fit": "api",
    "readout": "api",
    "reconstruct": "gaussians.reconstruct",
    "report_figures": "api",
    "score": "api",
    "score_truth": "evaluation.scoring",
    "segment": "api",
}

_FOLDERS = ("figures", "quality")  # whose functions are typed as `recon.quality.mtf`


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used."""
    if name in _FOLDERS:
        return import_module(f"recon.{name}")
    if name not in _HOMES:
        raise AttributeError(f"module 'recon' has no attribute {name!r}")
    return getattr(import_module(f"recon.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    """Public names."""
    return __all__
