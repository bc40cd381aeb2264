"""From spectral-CT counts to basis volumes, by Gaussians that know the physics.

>>> import recon
>>> recon.Recipe(spacing=2.0).stages
(Stage(pixel=1.0, sweeps=10.0),)

`recon.reconstruct(dataset, recipe)` is the whole way from an open dataset to a model. Names are imported when they are
first used, so that importing the package costs nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from recon.baselines.fdk import fdk
    from recon.gaussians import Gaussians
    from recon.pipeline import Reconstruction, reconstruct
    from recon.recipe import Recipe, Stage

__all__ = ["Gaussians", "Recipe", "Reconstruction", "Stage", "fdk", "reconstruct"]

_HOMES = {
    "Gaussians": "gaussians",
    "Recipe": "recipe",
    "Reconstruction": "pipeline",
    "Stage": "recipe",
    "fdk": "baselines.fdk",
    "reconstruct": "pipeline",
}


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used."""
    if name not in _HOMES:
        raise AttributeError(f"module 'recon' has no attribute {name!r}")
    return getattr(import_module(f"recon.{_HOMES[name]}"), name)
