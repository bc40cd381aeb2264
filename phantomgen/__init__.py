"""Phantoms with known truth, and the spectral scans of them.

>>> import phantomgen
>>> scan = phantomgen.load("kedge-small", {"geometry.views": 9})
>>> scan.geometry
Geometry(circular: 29 views, 128 x 128 pixels of (1.6, 1.6) mm)

Names are imported when they are first used, so that importing the package costs nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from phantomgen.api import again, correct, degrade, import_scan, load, make, plan
    from phantomgen.building.scene import Scene
    from phantomgen.building.shapes import (
        Box,
        Capsule,
        Cone,
        Cylinder,
        Difference,
        Ellipsoid,
        Group,
        Head,
        Intersection,
        Mesh,
        Polygon,
        Sphere,
        Sweep,
        Torso,
        Torus,
        Tube,
        Union,
        Voxels,
    )
    from phantomgen.dataset.reader import Dataset, open_dataset
    from phantomgen.dataset.reader import open_dataset as open  # noqa: A004
    from phantomgen.dataset.truth import Truth, read_truth
    from phantomgen.degradation.settings import Degradation
    from phantomgen.geometry.panel import Panel
    from phantomgen.geometry.poses import Geometry
    from phantomgen.geometry.voxel_grid import Grid
    from phantomgen.scene.scan import Scan
    from phantomgen.simulation.options import SimulationOptions

__all__ = [
    "Box",
    "Capsule",
    "Cone",
    "Cylinder",
    "Dataset",
    "Degradation",
    "Difference",
    "Ellipsoid",
    "Geometry",
    "Grid",
    "Group",
    "Head",
    "Intersection",
    "Mesh",
    "Panel",
    "Polygon",
    "Scan",
    "Scene",
    "SimulationOptions",
    "Sphere",
    "Sweep",
    "Torso",
    "Torus",
    "Truth",
    "Tube",
    "Union",
    "Voxels",
    "again",
    "correct",
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
    "Box": ("building.shapes", "Box"),
    "Capsule": ("building.shapes", "Capsule"),
    "Cone": ("building.shapes", "Cone"),
    "Cylinder": ("building.shapes", "Cylinder"),
    "Dataset": ("dataset.reader", "Dataset"),
    "Degradation": ("degradation.settings", "Degradation"),
    "Difference": ("building.shapes", "Difference"),
    "Ellipsoid": ("building.shapes", "Ellipsoid"),
    "Geometry": ("geometry.poses", "Geometry"),
    "Grid": ("geometry.voxel_grid", "Grid"),
    "Group": ("building.shapes", "Group"),
    "Head": ("building.shapes", "Head"),
    "Intersection": ("building.shapes", "Intersection"),
    "Mesh": ("building.shapes", "Mesh"),
    "Panel": ("geometry.panel", "Panel"),
    "Polygon": ("building.shapes", "Polygon"),
    "Scan": ("scene.scan", "Scan"),
    "Scene": ("building.scene", "Scene"),
    "SimulationOptions": ("simulation.options", "SimulationOptions"),
    "Sphere": ("building.shapes", "Sphere"),
    "Sweep": ("building.shapes", "Sweep"),
    "Torso": ("building.shapes", "Torso"),
    "Torus": ("building.shapes", "Torus"),
    "Truth": ("dataset.truth", "Truth"),
    "Tube": ("building.shapes", "Tube"),
    "Union": ("building.shapes", "Union"),
    "Voxels": ("building.shapes", "Voxels"),
    "again": ("api", "again"),
    "correct": ("api", "correct"),
    "degrade": ("api", "degrade"),
    "import_scan": ("api", "import_scan"),
    "load": ("api", "load"),
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
