"""First Gaussians: random voxels of a filtered back-projection of the lowest channel, as in R2-Gaussian."""

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from phantomgen.geometry.voxel_grid import Grid
from recon.published_methods.paper.fractions import fractions_of_density
from recon.published_methods.paper.model import FactorisedGaussians, Units
from recon.published_methods.paper.recipe import PaperRecipe
from spectra.errors import InputError

NEIGHBOURS = 3
TOP = 0.999  # quantile of the voxels above zero that counts as density 1


def units_of(volume: Float[np.ndarray, "z y x"], grid: Grid, recipe: PaperRecipe) -> Units:
    """Units in which the volume's highest density is 1 and the grid's longest edge 2.

    Raises
    ------
    InputError
        When no voxel of the volume is above zero.
    """
    if not (volume > 0).any():
        raise InputError("the scan shows nothing: filtered back-projection of its lowest channel is nowhere positive")
    return Units.of(grid, float(np.quantile(volume[volume > 0], TOP)), recipe.narrowest, recipe.widest)


def first_gaussians(
    volume: Float[np.ndarray, "z y x"],
    grid: Grid,
    means: Float[np.ndarray, " basis"],
    units: Units,
    recipe: PaperRecipe,
) -> FactorisedGaussians:
    """Gaussians at the centres of random voxels that are dense enough.

    Parameters
    ----------
    volume : attenuation seen by the lowest channel [1/mm]
    grid : grid of `volume`
    means : mean of each basis function over what the lowest channel counts
    units : of the scene
    recipe : numbers and components

    Notes
    -----
    Standard deviations are the root mean square distance to the three nearest neighbours. R2-Gaussian places its points
    half a voxel off; here they are at voxel centres. Densities are attenuation over what the fractions attenuate in
    this channel, so that the start projects as the volume does.
    """
    rng = np.random.default_rng([recipe.seed, 1])
    voxels = np.argwhere(volume > recipe.emptiest * units.density)
    if len(voxels) > recipe.gaussians:
        voxels = voxels[np.sort(rng.choice(len(voxels), recipe.gaussians, replace=False))]
    centres = (np.array(grid.origin) + voxels * np.array(grid.spacing))[:, ::-1].copy()
    attenuation = volume[tuple(voxels.T)].astype(np.float64)
    fractions = _fractions(attenuation, len(means), recipe)
    density = recipe.density_share * attenuation / _attenuation_of(fractions, means)
    sigma = np.clip(_neighbour_distance(centres, min(grid.spacing)), units.narrowest, units.widest)
    return FactorisedGaussians.of(centres, density, np.repeat(sigma[:, None], 3, axis=1), fractions, units)


def start_volumes(
    volume: Float[np.ndarray, "z y x"], means: Float[np.ndarray, " basis"], units: Units, recipe: PaperRecipe
) -> Float[np.ndarray, "basis z y x"]:
    """What the start says of each basis, voxel by voxel: the volume, split by the first fractions [1/mm]."""
    out = np.zeros((len(means), *volume.shape))
    dense = volume > recipe.emptiest * units.density
    attenuation = volume[dense].astype(np.float64)
    fractions = _fractions(attenuation, len(means), recipe)
    out[:, dense] = (fractions * (attenuation / _attenuation_of(fractions, means))[:, None]).T
    return out


def _fractions(
    attenuation: Float[np.ndarray, " voxel"], bases: int, recipe: PaperRecipe
) -> Float[np.ndarray, "voxel basis"]:
    return fractions_of_density(attenuation, bases, recipe.uses("fraction-start"), recipe.uses("kedge-gate"))


def _attenuation_of(
    fractions: Float[np.ndarray, "voxel basis"], means: Float[np.ndarray, " basis"]
) -> Float[np.ndarray, " voxel"]:
    """Attenuation per density; never less than a tenth of the largest mean, as a conditioned column may be negative."""
    return np.maximum(fractions @ means, 0.1 * np.abs(means).max())


def _neighbour_distance(points: Float[np.ndarray, "point 3"], default: float) -> Float[np.ndarray, " point"]:
    """Root mean square distance to the nearest points [mm]; `default` for a lonely one."""
    count = min(NEIGHBOURS, len(points) - 1)
    if count < 1:
        return np.full(len(points), default)
    return np.sqrt((KDTree(points).query(points, k=count + 1)[0][:, 1:] ** 2).mean(axis=1))
