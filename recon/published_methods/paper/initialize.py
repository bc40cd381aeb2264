"""First Gaussians: random voxels of a filtered back-projection of the lowest channel, as in R2-Gaussian.

First material fractions follow from density: a dense voxel is photoelectric, a very dense one also K edge.
"""

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree
from scipy.special import expit

from phantomgen.geometry.voxel_grid import Grid
from recon.published_methods.paper.model import FactorisedGaussians, Units
from recon.published_methods.paper.recipe import PaperRecipe
from spectra.errors import InputError

NEIGHBOURS = 3  # nearest points whose distances give the first standard deviation; R2-Gaussian
TOP = 0.999  # quantile of the positive voxels that is density 1 in the normalised scene; our choice
LEAST_MEAN = (
    0.1  # no unit; least attenuation per density over the largest mean, as a conditioned column may be negative
)
MOST_EDGE = 0.5  # no unit; f_max, largest part of f_PE that becomes K edge; our choice
UNGATED = 0.2  # no unit; value of the gate g where the component is switched off; our choice
ODDS = float(np.log(9.0))  # log odds; a sigmoid rises from 0.5 to 0.9 between the two quantiles that set its slope
MIDDLE, HIGH = 0.5, 0.9  # quantiles of density that set rho_0 and the slope a; our choice
DENSE, DENSEST = 0.95, 0.99  # quantiles of density that set rho_K and the slope a_K; our choice
LEAST_SPREAD = 1e-3  # no unit; least relative difference of two quantiles, for objects of one density


def units_of(volume: Float[np.ndarray, "z y x"], grid: Grid, recipe: PaperRecipe) -> Units:
    """Compute units in which the highest density of a volume is 1 and the longest edge of its grid 2.

    Parameters
    ----------
    volume : attenuation [1/mm]
    grid : grid of the volume
    recipe : bounds of standard deviations

    Returns
    -------
    units; the quantile `TOP` of the positive voxels is taken for the highest density

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
    """Place Gaussians at the centres of random voxels that are dense enough.

    Parameters
    ----------
    volume : attenuation in the lowest channel [1/mm]
    grid : grid of `volume`
    means : mean of each basis function over the counts of the lowest channel
    units : units of the scene
    recipe : numbers and components

    Returns
    -------
    first Gaussians

    Notes
    -----
    Standard deviations are the root mean square distance to the three nearest neighbours. R2-Gaussian places its points
    half a voxel off; here they are at voxel centres. The density of a Gaussian is the attenuation of its voxel, divided
    by that of its fractions per density in this channel: the start and the volume have the same projections.
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
    """Split a volume into the bases by the first fractions, voxel by voxel.

    Parameters
    ----------
    volume : attenuation in the lowest channel [1/mm]
    means : mean of each basis function over the counts of the lowest channel
    units : units of the scene
    recipe : numbers and components

    Returns
    -------
    coefficient of each basis [1/mm]; 0 in voxels that are not dense enough for a Gaussian
    """
    out = np.zeros((len(means), *volume.shape))
    dense = volume > recipe.emptiest * units.density
    attenuation = volume[dense].astype(np.float64)
    fractions = _fractions(attenuation, len(means), recipe)
    out[:, dense] = (fractions * (attenuation / _attenuation_of(fractions, means))[:, None]).T
    return out


def _fractions(
    attenuation: Float[np.ndarray, " voxel"], bases: int, recipe: PaperRecipe
) -> Float[np.ndarray, "voxel basis"]:
    """First fractions of voxels, with the components that the recipe uses."""
    return fractions_of_density(attenuation, bases, recipe.uses("fraction-start"), recipe.uses("kedge-gate"))


def _attenuation_of(
    fractions: Float[np.ndarray, "voxel basis"], means: Float[np.ndarray, " basis"]
) -> Float[np.ndarray, " voxel"]:
    """Attenuation per density of each voxel, at least `LEAST_MEAN` of the largest mean."""
    return np.maximum(fractions @ means, LEAST_MEAN * np.abs(means).max())


def _neighbour_distance(points: Float[np.ndarray, "point 3"], default: float) -> Float[np.ndarray, " point"]:
    """Root mean square distance to the nearest points [mm]; `default` for a single point."""
    count = min(NEIGHBOURS, len(points) - 1)
    if count < 1:
        return np.full(len(points), default)
    return np.sqrt((KDTree(points).query(points, k=count + 1)[0][:, 1:] ** 2).mean(axis=1))


def fractions_of_density(
    density: Float[np.ndarray, " gaussian"], bases: int, by_density: bool = True, gate: bool = True
) -> Float[np.ndarray, "gaussian basis"]:
    """Compute first fractions from density.

    Parameters
    ----------
    density : positive densities, in any unit
    bases : number of bases, 2 or 3
    by_density : whether fractions depend on density; they are equal otherwise
    gate : whether the K edge's part of f_PE depends on density

    Returns
    -------
    fractions of photoelectric, Compton and, for three bases, K edge, which add up to 1

    Notes
    -----
    f_PE = s(a (log rho - log rho_0)) and f_C = 1 - f_PE, with s the logistic function. With the gate
    g = s(a_K (rho / rho_K - 1)), f_K = f_max g f_PE is moved from photoelectric to the K edge. The paper takes rho_0,
    rho_K and both slopes from quantiles that it does not state; `MIDDLE`, `HIGH`, `DENSE` and `DENSEST` are our choice.
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
