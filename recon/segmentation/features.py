"""Features by which materials are distinguished.

The features are those of SpectralCTGaussians (section on basis material decomposition): the density rho = sum_m b_m,
the ratio kappa = log(1 + b_PE / (b_C + eps)), and the part f_K = b_K / rho of each K-edge column. Gaussians overlap,
and those at edges are flat: the coefficients of one Gaussian are not the density of the material there (`kedge`: soft
tissue of 20.3e-3 per mm consists of Gaussians of 2.4e-3 to 7.0e-3). By default, therefore, b are local values: those of
the whole model at the centre of each Gaussian or voxel. A Gaussian's own coefficients are the paper's choice.
"""

import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage

from phantomgen.geometry.voxel_grid import Grid
from recon.readouts.mechanisms import Mechanisms

EPSILON = 0.005  # Compton coefficient of water; keeps kappa finite where there is no Compton; our choice
AIR = 0.2  # density of water; voxels below it are air; lungs have 0.26 and more
FLAT = 0.12  # quantile `_HIGH` of the density; largest range among the neighbours of a voxel inside of a material
SIGNIFICANT = 0.02  # part of the density; least f_K of a material with a K edge; our choice
_HIGH = 0.9  # quantile of the density in voxels that are not air; our choice
_APART = 3  # voxels; distance of the two values whose difference is noise; our choice


def features_of(mechanisms: Mechanisms, parts: Float[np.ndarray, "mechanism ..."]) -> Float[np.ndarray, "feature ..."]:
    """Compute the features.

    Parameters
    ----------
    mechanisms : conversion that gave the parts
    parts : photoelectric, Compton and K-edge coefficients [1/mm]; negative values, which some methods give, are taken
        as 0

    Returns
    -------
    density rho [1/mm], kappa, and f_K of each K edge
    """
    parts = np.maximum(parts, 0.0)
    density = parts.sum(axis=0)
    ratio = np.log1p(parts[0] / (parts[1] + EPSILON * mechanisms.water[1]))
    return np.concatenate([[density], [ratio], parts[2:] / np.maximum(density, 1e-12)])


def air_density(mechanisms: Mechanisms) -> float:
    """Return the density below which a voxel is air.

    Parameters
    ----------
    mechanisms : conversion of coefficients, which knows water

    Returns
    -------
    density [1/mm]
    """
    return AIR * float(mechanisms.water.sum())


def flat_inside(parts: Float[np.ndarray, "mechanism z y x"], air: float) -> Bool[np.ndarray, "z y x"]:
    """Find voxels inside of a material: not air, and hardly different from their 26 neighbours.

    Parameters
    ----------
    parts : coefficients of mechanisms [1/mm]
    air : density below which a voxel is air [1/mm]

    Returns
    -------
    True inside of materials; in noisy volumes for the flattest half of the voxels that are not air
    """
    density = parts.sum(axis=0)
    filled = density > air
    if not filled.any():
        return filled
    spans = [ndimage.maximum_filter(p, 3) - ndimage.minimum_filter(p, 3) for p in parts]
    steps = np.sqrt(np.sum(np.square(spans), axis=0))
    limit = max(FLAT * float(np.quantile(density[filled], _HIGH)), float(np.median(steps[filled])))
    return filled & (steps <= limit) & (ndimage.minimum_filter(density, 3) > air)


def noise_of(features: Float[np.ndarray, "feature z y x"], inside: Bool[np.ndarray, "z y x"]) -> np.ndarray:
    """Estimate the standard deviation of the noise of each feature.

    Parameters
    ----------
    features : features of all voxels
    inside : True inside of materials

    Returns
    -------
    robust standard deviation of each feature. For f_K only voxels above `SIGNIFICANT` count: coefficients that are held
    at 0 show no noise
    """
    return np.array([noise_in(f, inside & (f > SIGNIFICANT) if k >= 2 else inside) for k, f in enumerate(features)])


def at_points(
    volumes: Float[np.ndarray, "basis z y x"], grid: Grid, points: Float[np.ndarray, "point 3"]
) -> Float[np.ndarray, "basis point"]:
    """Interpolate volumes linearly at points.

    Parameters
    ----------
    volumes : volumes
    grid : grid of the volumes
    points : points (x, y, z) [mm]

    Returns
    -------
    values at the points; outside of the grid those of the nearest voxel
    """
    places = voxel_places(grid, points)
    return np.stack([ndimage.map_coordinates(v, places, order=1, mode="nearest") for v in volumes])


def voxel_places(grid: Grid, points: Float[np.ndarray, "point 3"]) -> Float[np.ndarray, "3 point"]:
    """Convert points from mm to voxels.

    Parameters
    ----------
    grid : grid of the volume
    points : points (x, y, z) [mm]

    Returns
    -------
    positions along (z, y, x) [voxel]
    """
    origin, spacing = np.array(grid.origin), np.array(grid.spacing)
    return ((points[:, ::-1] - origin) / spacing).T


def noise_in(feature: Float[np.ndarray, "z y x"], inside: Bool[np.ndarray, "z y x"]) -> float:
    """Estimate the noise of one feature from differences of voxels that are three voxels apart.

    Parameters
    ----------
    feature : feature of all voxels
    inside : True inside of materials, where both voxels of a pair lie

    Returns
    -------
    robust standard deviation of the differences, over the root of 2
    """
    found = []
    for axis in range(3):
        (head, first), (tail, second) = (
            [np.take(a, range(*ends), axis) for a in (inside, feature)] for ends in _ends(feature.shape[axis])
        )
        found.append((first - second)[head & tail])
    return _spread(np.concatenate(found))


def _ends(length: int) -> tuple[tuple[int, int], tuple[int, int]]:
    """Ranges of the first and the second of two voxels along an axis."""
    apart = min(_APART, length - 1)
    return (0, length - apart), (apart, length)


def _spread(differences: np.ndarray) -> float:
    """Standard deviation of one of two values from their differences, by the median absolute difference."""
    return 1.4826 / np.sqrt(2) * float(np.median(np.abs(differences))) if len(differences) else 0.0
