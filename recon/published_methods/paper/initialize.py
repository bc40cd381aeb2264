"""First Gaussians: random voxels of a filtered back-projection of the lowest channel, as in R2-Gaussian.

First material fractions follow from density: dense means photoelectric, very dense means K edge.
"""

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree
from scipy.special import expit

from phantomgen.geometry.voxel_grid import Grid
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


def initial_volumes(
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


MOST_EDGE = 0.5  # f_K,max
UNGATED = 0.2  # of it where there is no gate
ODDS = float(np.log(9.0))  # a sigmoid goes from one half to nine tenths between the two quantiles that set its slope
MIDDLE, HIGH = 0.5, 0.9  # quantiles of density that set rho_0 and the slope a
DENSE, DENSEST = 0.95, 0.99  # quantiles that set rho_K and the slope a_K
LEAST_SPREAD = 1e-3  # between quantiles, relative; objects of one density give nearly a step


def fractions_of_density(
    density: Float[np.ndarray, " gaussian"], bases: int, by_density: bool = True, gate: bool = True
) -> Float[np.ndarray, "gaussian basis"]:
    """f_PE = s(a (log rho - log rho_0)) and f_C = 1 - f_PE; a gate moves part of f_PE to the K edge.

    With g = s(a_K (rho / rho_K - 1)) the K edge gets f_K = f_max g f_PE, and photoelectric keeps the rest. The paper
    takes rho_0, rho_K and both slopes from quantiles that it does not state.

    Parameters
    ----------
    density : positive, in any unit
    bases : 2 or 3
    by_density : whether fractions depend on density; they are equal otherwise
    gate : whether the K edge's part of f_PE depends on density
    """
    if not by_density:
        return np.full((len(density), bases), 1 / bases)
    middle, high, dense, densest = np.quantile(density, [MIDDLE, HIGH, DENSE, DENSEST])
    slope = ODDS / max(np.log(high / middle), LEAST_SPREAD)
    photoelectric = expit(slope * np.log(density / middle))
    if bases == 2:
        return np.stack([photoelectric, 1 - photoelectric], axis=1)
    steepness = ODDS / max(densest / dense - 1, LEAST_SPREAD)
    opening = expit(steepness * (density / dense - 1)) if gate else UNGATED
    edge = MOST_EDGE * opening * photoelectric
    return np.stack([photoelectric - edge, 1 - photoelectric, edge], axis=1)
