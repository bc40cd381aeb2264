"""Compile the kernels of scans ahead, by small scans that use each of them.

numba keeps compiled kernels on disk: a machine compiles them once, or again after an update.
"""

from collections.abc import Callable

from phantomgen.api import again, make
from phantomgen.building.scene import Scene
from phantomgen.building.shapes import Box, Capsule, Cone, Cylinder, Ellipsoid, Polygon, Sphere, Sweep, Torus, Tube

_PANEL, _VOLUME = {"rows": 6, "columns": 6, "pitch": 16}, {"voxels": 6, "size": 60}
_ORBIT = {"type": "circular", "sod": 300, "sdd": 480, "views": 2, "test_views": 0}


def scan_solids() -> None:
    """Scan solids whose chords have closed forms, and scan again with another spectrum."""
    shapes = [
        Cylinder(radius=28, length=50, material="water"),
        Sphere(radius=3, center=(15, 0, 0), material="Al"),
        Ellipsoid(radii=(2, 3, 4), center=(-15, 0, 0), material="Al"),
        Box(size=(4, 5, 6), center=(0, 15, 0), material="Al"),
        Tube(radius=4, inner_radius=2, length=8, center=(0, -15, 0), material="Al"),
        Capsule(radius=2, length=5, center=(9, 9, 0), material="Al"),
        Cone(radii=(3, 1), length=6, center=(-9, 9, 0), material="Al"),
        Polygon(points=((0, 0), (4, 0), (0, 4)), length=5, center=(9, -9, 0), material="Al"),
    ]
    scene = Scene(objects=shapes, panel=_PANEL, volume=_VOLUME, geometry=_ORBIT)
    with make(scene, keep_paths=True) as dataset:
        again(dataset, {"source.kvp": 100}).close()


def scan_rings_and_meshes() -> None:
    """Scan a torus and a mesh."""
    shapes = [
        Torus(radius=15, tube=4, material="water"),
        Sweep(points=((-20, 0, 9), (0, 5, 12), (20, 0, 9)), radius=2, material="Al"),
    ]
    make(Scene(objects=shapes, panel=_PANEL, volume=_VOLUME, geometry=_ORBIT)).close()


STEPS: dict[str, Callable[[], None]] = {"solids": scan_solids, "rings and meshes": scan_rings_and_meshes}
