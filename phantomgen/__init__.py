"""Phantoms with known truth, and the spectral scans of them.

>>> import phantomgen
>>> scan = phantomgen.load("kedge-small", ["geometry.views=9"])
>>> scan.geometry
Geometry(circular: 29 views, 128 x 128 pixels of (1.6, 1.6) mm)

Names are imported when they are first used, so that importing the package costs nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from phantomgen.dataset import Dataset, open_dataset
    from phantomgen.dataset import open_dataset as open  # noqa: A004
    from phantomgen.dataset_truth import Truth, read_truth
    from phantomgen.geometry import Geometry
    from phantomgen.grid import Grid
    from phantomgen.panel import Panel
    from phantomgen.scene import Scan, Scene
    from phantomgen.scene import load_scene as load
    from phantomgen.session import make, plan

__all__ = [
    "Dataset",
    "Geometry",
    "Grid",
    "Panel",
    "Scan",
    "Scene",
    "Truth",
    "load",
    "make",
    "open",
    "open_dataset",
    "plan",
    "read_truth",
]

_HOMES = {
    "Dataset": ("dataset", "Dataset"),
    "Geometry": ("geometry", "Geometry"),
    "Grid": ("grid", "Grid"),
    "Panel": ("panel", "Panel"),
    "Scan": ("scene", "Scan"),
    "Scene": ("scene", "Scene"),
    "Truth": ("dataset_truth", "Truth"),
    "load": ("scene", "load_scene"),
    "make": ("session", "make"),
    "open": ("dataset", "open_dataset"),
    "open_dataset": ("dataset", "open_dataset"),
    "plan": ("session", "plan"),
    "read_truth": ("dataset_truth", "read_truth"),
}


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used."""
    if name not in _HOMES:
        raise AttributeError(f"module 'phantomgen' has no attribute {name!r}")
    module, attribute = _HOMES[name]
    return getattr(import_module(f"phantomgen.{module}"), attribute)


def __dir__() -> list[str]:
    """Public names."""
    return __all__
