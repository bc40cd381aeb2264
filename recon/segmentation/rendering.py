"""Material maps as pictures: seen from any side, and in slices.

Seen from a side, a pixel has the mean colour of what its ray passes, and 1 - exp(-t) of full brightness, where t is
the line integral of the density: so nothing depends on the scene's largest value, and air is black.
"""

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy import ndimage

from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.ops.project import project
from recon.gaussians.model import Gaussians
from recon.ops.rasterize import rasterize
from recon.ops.voxelize import voxelize
from spectra.errors import InputError

PIXELS = 320  # along a side of a picture


def picture(
    lengths: Float[np.ndarray, "material row column"], colours: Float[np.ndarray, "material 3"]
) -> Float[np.ndarray, "row column 3"]:
    """RGB between 0 and 1 of the line integrals of each material's density."""
    lengths = np.maximum(lengths, 0.0).astype(np.float64)
    total = lengths.sum(axis=0)
    mean = np.tensordot(lengths, colours, axes=(0, 0)) / np.maximum(total, 1e-12)[..., None]
    return mean * -np.expm1(-total)[..., None]


def slices_rgb(
    materials: Float[np.ndarray, "material z y x"],
    densities: Float[np.ndarray, " material"],
    colours: Float[np.ndarray, "material 3"],
    filled: Bool[np.ndarray, "z y x"],
) -> Float[np.ndarray, "z y x 3"]:
    """RGB between 0 and 1: the colours of the materials, each by the part of the voxel that it fills.

    Voxels whose 26 neighbours all hold more material than air are full, whatever the densities say.

    Parameters
    ----------
    materials : density of each material, averaged over voxels [1/mm]
    densities : of voxels that a material fills [1/mm]
    filled : voxels that are not air
    """
    parts = np.maximum(materials, 0.0) / np.maximum(densities, 1e-12)[:, None, None, None]
    total = parts.sum(axis=0)
    full = ndimage.minimum_filter(filled, 3) & (total > 0)
    parts /= np.where(full, total, np.maximum(total, 1.0))
    return np.tensordot(parts, colours, axes=(0, 0))


def voxel_lengths(
    materials: Float[np.ndarray, "material z y x"], grid: Grid, geometry: Geometry
) -> Float[np.ndarray, "view material row column"]:
    """Line integrals of voxels."""
    panel = geometry.panel
    images = project(materials.astype(np.float32), grid, geometry.ray_frames(), panel.rows, panel.columns)
    return np.moveaxis(np.asarray(images), 0, 1)


def gaussian_lengths(
    gaussians: Gaussians, amounts: Float[np.ndarray, "gaussian material"], geometry: Geometry
) -> Float[np.ndarray, "view material row column"]:
    """Line integrals of Gaussians that carry some density of each material."""
    panel, frames = geometry.panel, torch.from_numpy(geometry.ray_frames())
    shapes = (gaussians.centres, gaussians.log_scales, gaussians.quaternions)
    with torch.no_grad():
        return rasterize(*shapes, torch.from_numpy(amounts), frames, panel.rows, panel.columns).numpy()


def gaussian_materials(
    gaussians: Gaussians, labels: Int[np.ndarray, " gaussian"], count: int, grid: Grid
) -> tuple[Float[np.ndarray, "gaussian material"], Float[np.ndarray, "material z y x"]]:
    """Density that each Gaussian gives to its material, and the volumes of the materials [1/mm]."""
    density = gaussians.coefficients.numpy().sum(axis=1)
    amounts = np.zeros((len(labels), count), np.float32)
    amounts[np.arange(len(labels)), labels] = density
    shapes = (gaussians.centres, gaussians.log_scales, gaussians.quaternions)
    return amounts, voxelize(*shapes, torch.from_numpy(amounts), grid)


def views_around(
    grid: Grid, angles: Sequence[tuple[float, float]], filled: Bool[np.ndarray, "z y x"] | None = None
) -> Geometry:
    """Parallel views of a whole grid, or of the box around what is filled.

    Parameters
    ----------
    grid : what is seen
    angles : azimuth, 0 from +x, and elevation above the plane z = 0 [degree]
    filled : voxels that are not air
    """
    low, high_end = _box(grid, filled)
    middle, size = ((low + high_end) / 2)[::-1], high_end - low
    azimuth, elevation = np.deg2rad(np.array(angles, dtype=np.float64)).T
    flat = np.cos(elevation)
    towards = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=1)
    right = np.stack([-np.sin(azimuth), np.cos(azimuth), np.zeros_like(azimuth)], axis=1)
    wide = float(np.hypot(*size[1:]))
    high = float(size[0]) if not elevation.any() else float(np.linalg.norm(size))
    pitch = max(wide, high) / PIXELS
    panel = Panel(int(np.ceil(high / pitch)), int(np.ceil(wide / pitch)), pitch)
    behind = middle - towards * np.linalg.norm(size)
    return Geometry.parallel(-towards, behind, pitch * right, -pitch * np.cross(towards, right), panel, azimuth)


def _box(grid: Grid, filled: Bool[np.ndarray, "z y x"] | None) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Lowest and highest corner (z, y, x) [mm], two voxels of air included."""
    first, last = np.zeros(3), np.array(grid.shape, dtype=np.float64) - 1
    if filled is not None and filled.any():
        places = np.nonzero(filled)
        first, last = np.array([p.min() for p in places]) - 2.0, np.array([p.max() for p in places]) + 2.0
    origin, spacing = np.array(grid.origin), np.array(grid.spacing)
    return origin + (first - 0.5) * spacing, origin + (last + 0.5) * spacing


def parse_views(texts: Sequence[str]) -> tuple[tuple[float, float], ...]:
    """``"30"`` or ``"30,20"`` as azimuth and elevation [degree].

    Raises
    ------
    InputError
        When a text is neither.
    """
    views = []
    for text in texts:
        try:
            numbers = [float(part) for part in text.split(",")]
        except ValueError:
            numbers = []
        if len(numbers) not in (1, 2) or not np.isfinite(numbers).all() or max(map(abs, numbers)) > 360:
            raise InputError(f"--view needs an azimuth, or azimuth,elevation, in degrees, got {text!r}")
        views.append((numbers[0], numbers[1] if len(numbers) > 1 else 0.0))
    return tuple(views)
