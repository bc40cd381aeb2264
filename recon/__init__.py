"""From spectral-CT counts to basis volumes, by Gaussians that know the physics.

>>> import recon
>>> recon.Recipe().stages
(Stage(pixel=0.5, sweeps=1.0),)

`recon.fit(dataset)` is the whole way from an open dataset to a fit that renders, scores and saves itself,
`recon.segment(fit)` finds its materials, and `recon.reconstruct(dataset, recipe)` is the bare computation. Names are
imported when they are first used, so that importing the package costs nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from recon.baselines.fdk import fdk
    from recon.gaussians import Gaussians
    from recon.pipeline import Reconstruction, reconstruct
    from recon.recipe import Recipe, Stage
    from recon.session import Fit, fit, segment

__all__ = ["Fit", "Gaussians", "Recipe", "Reconstruction", "Stage", "fdk", "fit", "reconstruct", "segment"]

_HOMES = {
    "Fit": "session",
    "Gaussians": "gaussians",
    "Recipe": "recipe",
    "Reconstruction": "pipeline",
    "Stage": "recipe",
    "fdk": "baselines.fdk",
    "fit": "session",
    "reconstruct": "pipeline",
    "segment": "session",
}


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used."""
    if name not in _HOMES:
        raise AttributeError(f"module 'recon' has no attribute {name!r}")
    return getattr(import_module(f"recon.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    """Public names."""
    return __all__
