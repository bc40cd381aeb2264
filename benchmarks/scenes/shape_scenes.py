"""The scenes that projectors are compared with: 4, 101 and 1001 shapes, 256 x 256 pixels of 1 mm, SOD 500, SDD 1000."""

import numpy as np

from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry
from phantomgen.shapes import Cylinder, Ellipsoid, Shape, Sphere

SIDE, SOD, SDD, VIEWS = 256, 500.0, 1000.0, 24
# Attenuation of the materials of the scenes [1/mm]: soft tissue, bone, K edge, soft insert.
ATTENUATION = (0.02, 0.05, 0.04, 0.01)


def frames() -> np.ndarray:
    """Rays of all views as `expected_counts` takes them."""
    angles = np.linspace(0, 2 * np.pi, VIEWS, endpoint=False)
    return Geometry.circular(SOD, SDD, angles, Panel(SIDE, SIDE, 1.0)).ray_frames()


def shapes(count: int) -> list[tuple[Shape, int]]:
    """Shapes with the index of their material: 4 of different kinds, strictly nested, or a cylinder full of spheres."""
    body = Cylinder((0, 0, 0), 50.0, 100.0)
    if count == 4:
        return [
            (body, 0),
            (Cylinder((20, 0, 0), 12.0, 80.0), 1),
            (Cylinder((-15, 18, 5), 10.0, 60.0), 2),
            (Ellipsoid((0, -20, 0), (15, 8, 20), (0, 0, np.pi / 6)), 3),
        ]
    side = {101: (5, 5, 4), 1001: (10, 10, 10)}[count]
    places = [np.linspace(-1, 1, n) * reach for n, reach in zip(side, (30, 30, 44), strict=True)]
    radius = 0.4 * min(2 * reach / (n - 1) for n, reach in zip(side, (30, 30, 44), strict=True))
    grid = np.stack(np.meshgrid(*places, indexing="ij"), axis=-1).reshape(-1, 3)
    return [(body, 0), *((Sphere(tuple(center), radius), 1 + i % 3) for i, center in enumerate(grid.tolist()))]
