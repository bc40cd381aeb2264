"""Voxels for a scan whose format asks for none: what its panel sees, in voxels as large as pixels at the axis."""

from math import ceil

import numpy as np
from jaxtyping import Float

from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid

MOST = 256  # voxels along an edge, unless more are asked for


def seen_grid(geometry: Geometry, voxels: int | None = None, size: float | None = None) -> Grid:
    """Create a grid of cubic voxels around all that every view sees.

    Parameters
    ----------
    geometry : poses
    voxels : number along x and y; where left out, as many as make voxels as large as a pixel at the axis, 256 at most
    size : extent along x and y [mm]; where left out, twice the radius that the panel sees

    Returns
    -------
    the grid
    """
    radius, low, high, pixel = _field(geometry)
    extent = size or 2 * radius
    count = voxels or min(MOST, max(1, round(extent / pixel)))
    spacing = extent / count
    slices = max(1, ceil((high - low) / spacing - 1e-9))
    if voxels is None and slices > 2 * MOST:
        spacing, slices = (high - low) / (2 * MOST), 2 * MOST
        count = max(1, ceil(extent / spacing - 1e-9))
    middle, half = (low + high) / 2, (count - 1) / 2 * spacing
    return Grid(
        (slices, count, count), (spacing, spacing, spacing), (middle - (slices - 1) / 2 * spacing, -half, -half)
    )


def _field(geometry: Geometry) -> tuple[float, float, float, float]:
    """Radius that is seen, lowest and highest z that is seen at the axis, and a pixel's size there [mm]."""
    sides = [_at_axis(geometry, row, column) for row in (-0.5, 0.5) for column in (-0.5, 0.5)]
    radius = np.median(np.max([distance for distance, _ in sides], axis=0))
    heights = np.array([z for _, z in sides])
    return float(radius), float(heights.min()), float(heights.max()), _pixel_at_axis(geometry)


def _pixel_at_axis(geometry: Geometry) -> float:
    """Size of a pixel at the axis, median over the views [mm]."""
    if geometry.is_parallel:
        return geometry.panel.column_pitch
    ray = geometry.panel_center - geometry.source
    depth = np.abs(np.einsum("vi,vi->v", ray, geometry.normals()))
    to_axis = np.abs(np.einsum("vi,vi->v", -geometry.source * [1, 1, 0], geometry.normals()))
    return float(geometry.panel.column_pitch * np.median(to_axis / depth))


def _at_axis(
    geometry: Geometry, row: float, column: float
) -> tuple[Float[np.ndarray, " view"], Float[np.ndarray, " view"]]:
    """Distance from the axis, and z where it is nearest, of the ray to a point of the panel, -0.5 to 0.5 across it."""
    panel = geometry.panel
    point = geometry.panel_center + column * panel.columns * geometry.column_step + row * panel.rows * geometry.row_step
    direction = point - geometry.source if geometry.ray_direction is None else geometry.ray_direction
    across = np.einsum("vi,vi->v", direction[:, :2], direction[:, :2])
    distance = np.abs(point[:, 0] * direction[:, 1] - point[:, 1] * direction[:, 0]) / np.sqrt(across)
    along = np.einsum("vi,vi->v", point[:, :2], direction[:, :2]) / across
    return distance, point[:, 2] - along * direction[:, 2]
