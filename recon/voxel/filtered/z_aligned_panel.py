"""Resampling of images from a tilted panel to a z-aligned one."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.ndimage import map_coordinates

from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry
from recon.voxel.filtered.circular_orbit import CircularOrbit


def on_z_aligned_panel(
    images: Float[np.ndarray, "view basis row column"], geometry: Geometry, circle: CircularOrbit
) -> tuple[Float[np.ndarray, "view basis new_row new_column"], Geometry]:
    """Resample images to a panel normal to the central ray whose rows are parallel to the plane of the circle.

    A line integral belongs to a ray and not to a panel, so each pixel of the new panel takes the value where its ray
    meets the old one, by cubic splines. The new panel covers all of the old one; pixels beyond take the value at the
    border.

    Parameters
    ----------
    images : line integrals on the tilted panel [no unit]
    geometry : poses of the tilted panel
    circle : orbit of `geometry`

    Returns
    -------
    images on the z-aligned panel, and its geometry
    """
    z_aligned = _z_aligned_panel(geometry, circle)
    rows, columns = np.meshgrid(np.arange(z_aligned.panel.rows), np.arange(z_aligned.panel.columns), indexing="ij")
    out = np.empty((*images.shape[:2], *rows.shape), np.float32)
    for view, (old, new) in enumerate(zip(geometry.ray_frames(), z_aligned.ray_frames(), strict=True)):
        rays = new[1] + columns[..., None] * new[2] + rows[..., None] * new[3]
        column, row, depth = np.moveaxis(rays @ np.linalg.inv(np.stack([old[2], old[3], old[1]], axis=-1)).T, -1, 0)
        for basis, image in enumerate(images[view]):
            out[view, basis] = map_coordinates(image, [row / depth, column / depth], order=3, mode="nearest")
    return out, z_aligned


def _z_aligned_panel(geometry: Geometry, circle: CircularOrbit) -> Geometry:
    """z-aligned panels at the distance of the tilted ones, large enough to cover them in all views."""
    tangent = np.stack([-circle.outward[:, 1], circle.outward[:, 0], np.zeros(len(geometry))], axis=1)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    tangent *= np.where(np.einsum("vi,vi->v", tangent, geometry.column_step) < 0, -1.0, 1.0)[:, None]
    normal = np.stack([tangent[:, 1], -tangent[:, 0], np.zeros(len(geometry))], axis=1)
    normal *= np.where(np.einsum("vi,vi->v", normal, circle.outward) < 0, 1.0, -1.0)[:, None]
    down = np.array([0.0, 0.0, -1.0]) * np.where(geometry.row_step[:, 2] > 0, -1.0, 1.0)[:, None]
    across, along = _extent(geometry, tangent, down, normal, circle.sdd)
    pitches = np.array([geometry.panel.row_pitch, geometry.panel.column_pitch])
    first, last = (np.array([along[i], across[i]]) for i in (0, 1))
    rows, columns = np.maximum(np.ceil((last - first) / pitches - 1e-6).astype(int), 2)
    (v, u) = (first + last) / 2
    center = geometry.source + circle.sdd[:, None] * normal + u * tangent + v * down
    return replace(
        geometry,
        panel_center=center,
        column_step=pitches[1] * tangent,
        row_step=pitches[0] * down,
        panel=Panel(int(rows), int(columns), (float(pitches[0]), float(pitches[1]))),
    )


def _extent(
    geometry: Geometry,
    tangent: Float[np.ndarray, "view 3"],
    down: Float[np.ndarray, "view 3"],
    normal: Float[np.ndarray, "view 3"],
    distance: Float[np.ndarray, " view"],
) -> tuple[Float[np.ndarray, " 2"], Float[np.ndarray, " 2"]]:
    """Smallest and largest position across and along where rays to the panel corners meet the upright plane [mm]."""
    panel, frames = geometry.panel, geometry.ray_frames()
    across, along = [], []
    for column in (-0.5, panel.columns - 0.5):
        for row in (-0.5, panel.rows - 0.5):
            rays = frames[:, 1] + column * frames[:, 2] + row * frames[:, 3]
            rays *= (distance / np.einsum("vi,vi->v", rays, normal))[:, None]
            across.append(np.einsum("vi,vi->v", rays, tangent))
            along.append(np.einsum("vi,vi->v", rays, down))
    return tuple(np.array([np.min(values), np.max(values)]) for values in (across, along))  # type: ignore[return-value]
