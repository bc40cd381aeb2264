"""RGB images of material maps: views from any direction, and slices.

In a view, a pixel has the mean colour of the materials along its ray, and 1 - exp(-t) of full brightness, where t is
the line integral of the density. Brightness does not depend on the largest value of the volume, and air is black.
"""

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy import ndimage

from phantomgen.geometry.curved_panel import module_frames
from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.ops.project import project
from recon.gaussians.model import Gaussians
from recon.ops.rasterize import rasterize
from recon.ops.voxelize import voxelize
from spectra.errors import InputError

PIXELS = 320  # pixels; along the longer side of a picture


def picture(
    lengths: Float[np.ndarray, "material row column"], colours: Float[np.ndarray, "material 3"]
) -> Float[np.ndarray, "row column 3"]:
    """Compute the RGB image of a view.

    Parameters
    ----------
    lengths : line integrals of the density of each material [no unit]
    colours : RGB of each material, 0 to 1

    Returns
    -------
    RGB, 0 to 1
    """
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
    """Compute RGB of all voxels: the colours of the materials, each weighted by the part of the voxel that it fills.

    Parameters
    ----------
    materials : density of each material, averaged over voxels [1/mm]
    densities : density of voxels that a material fills [1/mm]
    colours : RGB of each material, 0 to 1
    filled : True for voxels that are not air

    Returns
    -------
    RGB, 0 to 1; a voxel whose 26 neighbours are not air is taken for full, whatever the sum of its densities
    """
    parts = np.maximum(materials, 0.0) / np.maximum(densities, 1e-12)[:, None, None, None]
    total = parts.sum(axis=0)
    full = ndimage.minimum_filter(filled, 3) & (total > 0)
    parts /= np.where(full, total, np.maximum(total, 1.0))
    return np.tensordot(parts, colours, axes=(0, 0))


def voxel_lengths(
    materials: Float[np.ndarray, "material z y x"], grid: Grid, geometry: Geometry
) -> Float[np.ndarray, "view material row column"]:
    """Compute line integrals of volumes.

    Parameters
    ----------
    materials : density of each material [1/mm]
    grid : grid of the volumes
    geometry : poses of the views

    Returns
    -------
    line integrals [no unit]
    """
    panel = geometry.panel
    images = project(materials.astype(np.float32), grid, module_frames(geometry), panel.rows, panel.columns)
    return np.moveaxis(np.asarray(images), 0, 1)


def gaussian_lengths(
    gaussians: Gaussians, amounts: Float[np.ndarray, "gaussian material"], geometry: Geometry
) -> Float[np.ndarray, "view material row column"]:
    """Compute line integrals of Gaussians.

    Parameters
    ----------
    gaussians : centres, scales and orientations
    amounts : density of each material at the centre of each Gaussian [1/mm]
    geometry : poses of the views

    Returns
    -------
    line integrals [no unit]
    """
    panel, frames = geometry.panel, torch.from_numpy(module_frames(geometry))
    shapes = (gaussians.centres, gaussians.log_scales, gaussians.quaternions)
    with torch.no_grad():
        return rasterize(*shapes, torch.from_numpy(amounts), frames, panel.rows, panel.columns).numpy()


def gaussian_materials(
    gaussians: Gaussians, labels: Int[np.ndarray, " gaussian"], count: int, grid: Grid
) -> tuple[Float[np.ndarray, "gaussian material"], Float[np.ndarray, "material z y x"]]:
    """Compute the volume of each material from labelled Gaussians.

    Parameters
    ----------
    gaussians : model
    labels : material of each Gaussian
    count : number of materials
    grid : grid of the volumes

    Returns
    -------
    density of each material at the centre of each Gaussian [1/mm], and volumes of the materials [1/mm]
    """
    density = gaussians.coefficients.numpy().sum(axis=1)
    amounts = np.zeros((len(labels), count), np.float32)
    amounts[np.arange(len(labels)), labels] = density
    shapes = (gaussians.centres, gaussians.log_scales, gaussians.quaternions)
    return amounts, voxelize(*shapes, torch.from_numpy(amounts), grid)


def views_around(
    grid: Grid, angles: Sequence[tuple[float, float]], filled: Bool[np.ndarray, "z y x"] | None = None
) -> Geometry:
    """Create parallel views of a whole grid, or of the box around what is filled.

    Parameters
    ----------
    grid : grid of the volume
    angles : azimuth, 0 from +x, and elevation above the plane z = 0 [degree]
    filled : True for voxels that are not air; None for the whole grid

    Returns
    -------
    poses of the views, with a panel on which the whole box is visible
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
    """Read ``"30"`` or ``"30,20"`` as azimuth and elevation.

    Parameters
    ----------
    texts : one text per view

    Returns
    -------
    azimuth and elevation of each view [degree]

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
