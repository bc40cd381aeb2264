"""Radiative Gaussians that predict views only, after X-Gaussian.

A Gaussian adds radiance that does not depend on the path length of a ray in it. No volume has such projections: the
method returns none, and bases get no score. The start is X-Gaussian's: a uniform cuboid of points with random radiance,
no filtered back-projection. Simplified: radiances add up, where the original composites them by depth with clamped
opacities; pixels are sampled at their centres, where the original widens footprints by 0.3 pixel^2; opacities are not
reset.

References
----------
Cai, Liang, Wang, Wang, Zhang, Yang, Zhou, Yuille 2024, Radiative Gaussian splatting for efficient X-ray novel view
synthesis, ECCV, arXiv:2403.04116.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float

from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from recon.published_methods.paper.model import FactorisedGaussians, Units
from recon.published_methods.paper.recipe import PaperRecipe
from recon.published_methods.splatting.primitives import Radiance
from recon.published_methods.splatting.training import Splatting, Training, seen_rays, train
from recon.voxel.method import Images, Iteration, OnIteration, Weights, no_callback
from spectra.threads import without_other_pools

BRIGHTEST = 0.999  # quantile of the images that is radiance 1 in the normalised scene; our choice
LEAST = 1e-12  # no unit; least mean radiance that is divided by
DIMMING_VIEWS = 8  # views, about; from which the mean radiance of the start is computed; our choice


@dataclass(frozen=True, eq=False)
class Views:
    """Log projections of each channel in any views, from radiative Gaussians.

    Parameters
    ----------
    trainings : one per channel; None for one that shows nothing
    """

    trainings: Sequence[Training | None]

    @torch.no_grad()
    def __call__(self, geometry: Geometry) -> Float[np.ndarray, "channel view row column"]:
        """Compute log projections in the views of a geometry (channel, view, row, column)."""
        nothing = np.zeros((len(geometry), geometry.panel.rows, geometry.panel.columns), np.float32)
        return np.stack(
            [
                nothing if t is None else t.primitives.images(t.model.centres, t.model, t.units, geometry)[:, 0].numpy()
                for t in self.trainings
            ]
        )


@dataclass(frozen=True)
class XGaussian(Splatting):
    """X-Gaussian as a method, a `recon.voxel.method.ViewMethod`.

    Parameters
    ----------
    gaussians : Gaussians of each channel in the cuboid at the start, about
    dssim : weight of structural dissimilarity
    clone_gradient : mean gradient in normalised detector coordinates that clones or splits a Gaussian
    """

    gaussians: int = 8000
    dssim: float = 0.2
    clone_gradient: float = 2.6e-5

    @property
    def name(self) -> str:
        """Name of the method for ``--method``."""
        return "x-gaussian"

    @without_other_pools()
    def learn_views(
        self,
        log_projections: Images,
        weights: Weights | None,
        geometry: Geometry,
        grid: Grid,
        on_iteration: OnIteration = no_callback,
    ) -> Views:
        """Fit Gaussians to log projections, and predict other views with them.

        Parameters
        ----------
        log_projections : one image per channel and view [no unit]
        weights : 0 for rays that were not measured; all others have equal statistical weight
        geometry : poses of the views
        grid : grid that holds the object
        on_iteration : called every few steps

        Returns
        -------
        function that computes log projections of all channels in other views
        """
        seen, recipe = seen_rays(log_projections, weights), self.recipe
        views = Views([_begin(images, seen, geometry, grid, recipe) for images in log_projections])
        nothing = np.zeros((0, 0, 0, 0), np.float32)

        def report(step: int, residual: float) -> None:
            on_iteration(Iteration(step, recipe.steps, residual, nothing, views=views))

        train(views.trainings, len(geometry), recipe, report)
        return views


def _begin(
    images: Float[np.ndarray, "view row column"],
    seen: Bool[np.ndarray, "view row column"],
    geometry: Geometry,
    grid: Grid,
    recipe: PaperRecipe,
) -> Training | None:
    """A cuboid of Gaussians with the mean radiance of the images; None for images that are nowhere positive."""
    brightest = float(np.quantile(images[seen], BRIGHTEST)) if seen.any() else 0.0
    if brightest <= 0:
        return None
    units, radiance = Units.of(grid, brightest, recipe.narrowest, recipe.widest), Radiance()
    rng = np.random.default_rng([recipe.seed, 1])
    centres, cell = _cuboid(grid, recipe.gaussians)
    random = rng.uniform(0, 2, len(centres))
    sigma = np.clip(np.tile(cell / 2, (len(centres), 1)), units.narrowest, None)
    every = max(len(geometry) // DIMMING_VIEWS, 1)
    model = FactorisedGaussians.of(centres, brightest * random, sigma, np.ones((len(centres), 1)), units)
    with torch.no_grad():
        bright = radiance.images(model.centres, model, units, geometry[::every])[:, 0].numpy()[seen[::every]].mean()
    dimmed = random * max(float(images[::every][seen[::every]].mean()), 0.0) / max(float(bright), LEAST)
    model = FactorisedGaussians.of(centres, brightest * dimmed, sigma, np.ones((len(centres), 1)), units)
    return Training(model, radiance, images, seen, geometry, grid, units, recipe)


def _cuboid(grid: Grid, count: int) -> tuple[Float[np.ndarray, "gaussian 3"], Float[np.ndarray, "3"]]:
    """Centres (x, y, z) of about `count` equal cells of a grid, and the size of a cell [mm]."""
    size = np.array(grid.shape[::-1]) * grid.spacing[::-1]
    first = np.array(grid.origin[::-1]) - np.array(grid.spacing[::-1]) / 2
    numbers = np.maximum(np.round(size * (count / size.prod()) ** (1 / 3)), 1).astype(int)
    axes = [f + (np.arange(n) + 0.5) * s / n for f, n, s in zip(first, numbers, size, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3), size / numbers
