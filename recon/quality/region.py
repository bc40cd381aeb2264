"""Regions of interest: their mean and noise, and the contrast between two."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Real

from phantomgen.geometry.voxel_grid import Grid
from spectra.errors import InputError


@dataclass(frozen=True)
class Statistics:
    """Values in a region of interest.

    Parameters
    ----------
    mean : in the unit of the volume
    noise : standard deviation between voxels, in the unit of the volume
    voxels : number of voxels
    """

    mean: float
    noise: float
    voxels: int


def ball(grid: Grid, center: tuple[float, float, float], radius: float) -> Bool[np.ndarray, "z y x"]:
    """Mark the voxels whose centres lie in a ball.

    Parameters
    ----------
    grid : the voxels
    center : (x, y, z) [mm]
    radius : [mm]

    Returns
    -------
    True inside
    """
    x, y, z = _distances(grid, center)
    return x**2 + y**2 + z**2 <= _positive(radius, "radius") ** 2


def rod(grid: Grid, center: tuple[float, float, float], radius: float, length: float) -> Bool[np.ndarray, "z y x"]:
    """Mark the voxels whose centres lie in a cylinder along z.

    Parameters
    ----------
    grid : the voxels
    center : (x, y, z) [mm]
    radius, length : [mm]

    Returns
    -------
    True inside
    """
    x, y, z = _distances(grid, center)
    return (x**2 + y**2 <= _positive(radius, "radius") ** 2) & (np.abs(z) <= _positive(length, "length") / 2)


def statistics(volume: Real[np.ndarray, "z y x"], region: Bool[np.ndarray, "z y x"]) -> Statistics:
    """Compute mean and noise of a region.

    Parameters
    ----------
    volume : values of the voxels
    region : True inside

    Returns
    -------
    mean, standard deviation (of n - 1), number of voxels

    Raises
    ------
    InputError
        When the region has another shape than the volume, fewer than two voxels, or a value that is not finite.
    """
    volume, region = np.asarray(volume), np.asarray(region, dtype=bool)
    if volume.shape != region.shape:
        raise InputError(f"a region must have the shape of the volume, {volume.shape}, got {region.shape}")
    values = volume[region].astype(np.float64)
    if values.size < 2:
        raise InputError(f"a region needs at least two voxels, got {values.size}: is it inside the grid?")
    if not np.isfinite(values).all():
        raise InputError(f"{np.sum(~np.isfinite(values))} of {values.size} values in the region are not finite")
    return Statistics(float(values.mean()), float(values.std(ddof=1)), int(values.size))


def contrast_to_noise(
    volume: Real[np.ndarray, "z y x"],
    region: Bool[np.ndarray, "z y x"],
    background: Bool[np.ndarray, "z y x"],
) -> float:
    """Compute the contrast-to-noise ratio of a region: the difference of the means over the noise of the background.

    Parameters
    ----------
    volume : values of the voxels
    region, background : True inside

    Returns
    -------
    ratio, negative where the region is darker; infinite without noise

    References
    ----------
    Bushberg et al., The Essential Physics of Medical Imaging, 3rd edition, section 4.8: CNR = (S - B) / sigma_B.
    """
    inside, outside = statistics(volume, region), statistics(volume, background)
    difference = inside.mean - outside.mean
    return difference / outside.noise if outside.noise > 0 else float(np.copysign(np.inf, difference))


def _distances(grid: Grid, center: tuple[float, float, float]) -> tuple[Float[np.ndarray, "..."], ...]:
    """Distances along x, y and z of the voxels from a point, ready to broadcast."""
    place = np.asarray(center, dtype=np.float64)
    if place.shape != (3,) or not np.isfinite(place).all():
        raise InputError(f"the centre of a region is (x, y, z) [mm], got {center!r}")
    x, y, z = (grid.axis(axis) - place["xyz".index(axis)] for axis in "xyz")
    return x[None, None, :], y[None, :, None], z[:, None, None]


def _positive(value: float, name: str) -> float:
    """A length that is positive."""
    if not 0 < value < np.inf:
        raise InputError(f"the {name} of a region must be positive and finite [mm], got {value!r}")
    return float(value)
