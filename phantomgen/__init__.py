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
    from phantomgen.api import degrade, import_scan, make, plan
    from phantomgen.dataset.reader import Dataset, open_dataset
    from phantomgen.dataset.reader import open_dataset as open  # noqa: A004
    from phantomgen.dataset.truth import Truth, read_truth
    from phantomgen.degradation.settings import Degradation
    from phantomgen.geometry.panel import Panel
    from phantomgen.geometry.poses import Geometry
    from phantomgen.geometry.voxel_grid import Grid
    from phantomgen.scene.scan import Scan, Scene
    from phantomgen.scene.scan import load_scene as load

__all__ = [
    "Dataset",
    "Degradation",
    "Geometry",
    "Grid",
    "Panel",
    "Scan",
    "Scene",
    "Truth",
    "degrade",
    "import_scan",
    "load",
    "make",
    "open",
    "open_dataset",
    "plan",
    "read_truth",
]

_HOMES = {
    "Dataset": ("dataset.reader", "Dataset"),
    "Degradation": ("degradation.settings", "Degradation"),
    "Geometry": ("geometry.poses", "Geometry"),
    "Grid": ("geometry.voxel_grid", "Grid"),
    "Panel": ("geometry.panel", "Panel"),
    "Scan": ("scene.scan", "Scan"),
    "Scene": ("scene.scan", "Scene"),
    "Truth": ("dataset.truth", "Truth"),
    "degrade": ("api", "degrade"),
    "import_scan": ("api", "import_scan"),
    "load": ("scene.scan", "load_scene"),
    "make": ("api", "make"),
    "open": ("dataset.reader", "open_dataset"),
    "open_dataset": ("dataset.reader", "open_dataset"),
    "plan": ("api", "plan"),
    "read_truth": ("dataset.truth", "read_truth"),
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
