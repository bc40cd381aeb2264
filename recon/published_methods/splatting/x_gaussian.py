"""Radiative Gaussians for novel views only, after X-Gaussian (Cai et al. 2024, arXiv:2403.04116).

A Gaussian adds radiance that does not depend on how long a ray is inside it, so that views agree with no volume: there
is none to return, and no basis can be scored. The start is X-Gaussian's: a uniform cuboid of points with random
radiance, no filtered back-projection. Simplified: radiances add up, where the original composites them by depth with
clamped opacities; the pixel is sampled, where the original widens footprints by 0.3 pixel^2; opacities are not reset.
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
from recon.published_methods.splatting.training import UNUSED, Training, paced, seen_rays, train
from recon.voxel.method import Images, Iteration, OnIteration, Weights, unwatched
from spectra.threads import without_other_pools

BRIGHTEST = 0.999  # quantile of the images that counts as radiance 1
LEAST = 1e-12  # of a mean that is divided by


@dataclass(frozen=True, eq=False)
class Views:
    """What radiative Gaussians show of each channel from anywhere.

    Parameters
    ----------
    trainings : one per channel; None for one that shows nothing
    """

    trainings: Sequence[Training | None]

    @torch.no_grad()
    def __call__(self, geometry: Geometry) -> Float[np.ndarray, "channel view row column"]:
        """Log projections in the views of a geometry."""
        nothing = np.zeros((len(geometry), geometry.panel.rows, geometry.panel.columns), np.float32)
        return np.stack(
            [
                nothing if t is None else t.look.images(t.model.centres, t.model, t.units, geometry)[:, 0].numpy()
                for t in self.trainings
            ]
        )


@dataclass(frozen=True)
class XGaussian:
    """X-Gaussian as a method.

    Other numbers are those of R2-Gaussian, see `recon.published_methods.splatting.r2_gaussian`.

    Parameters
    ----------
    iterations : Adam steps of each channel, one view each
    gaussians, most : of each channel in the cuboid at the start, about, and at most
    dssim : weight of structural dissimilarity
    clone_gradient : mean gradient on the panel that clones or splits a Gaussian
    pace : learning rates over those of R2-Gaussian
    seed : of the first radiances, the order of views and split offsets
    """

    iterations: int = 500
    gaussians: int = 8000
    most: int = 40_000
    dssim: float = 0.2
    clone_gradient: float = 2.6e-5
    pace: float = 8.0
    seed: int = 0

    @property
    def name(self) -> str:
        """What ``--method`` calls it."""
        return "x-gaussian"

    @property
    def recipe(self) -> PaperRecipe:
        """All numbers."""
        recipe = PaperRecipe(
            steps=self.iterations, without=UNUSED, seed=self.seed, gaussians=self.gaussians, most=self.most,
            dssim=self.dssim, clone_gradient=self.clone_gradient,
        )  # fmt: skip
        return paced(recipe, self.pace)

    @without_other_pools()
    def learn_views(
        self,
        log_projections: Images,
        weights: Weights | None,
        geometry: Geometry,
        grid: Grid,
        on_iteration: OnIteration = unwatched,
    ) -> Views:
        """See `recon.voxel.method.ViewMethod`."""
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
    """A cuboid of Gaussians as bright as the images in the mean; None for images that are nowhere positive."""
    brightest = float(np.quantile(images[seen], BRIGHTEST)) if seen.any() else 0.0
    if brightest <= 0:
        return None
    units, look = Units.of(grid, brightest, recipe.narrowest, recipe.widest), Radiance()
    rng = np.random.default_rng([recipe.seed, 1])
    centres, cell = _cuboid(grid, recipe.gaussians)
    random, sigma = (
        rng.uniform(0, 2, len(centres)),
        np.clip(np.tile(cell / 2, (len(centres), 1)), units.narrowest, None),
    )
    every = max(len(geometry) // 8, 1)
    model = FactorisedGaussians.of(centres, brightest * random, sigma, np.ones((len(centres), 1)), units)
    with torch.no_grad():
        bright = look.images(model.centres, model, units, geometry[::every])[:, 0].numpy()[seen[::every]].mean()
    dimmed = random * max(float(images[::every][seen[::every]].mean()), 0.0) / max(float(bright), LEAST)
    model = FactorisedGaussians.of(centres, brightest * dimmed, sigma, np.ones((len(centres), 1)), units)
    return Training(model, look, images, seen, geometry, grid, units, recipe)


def _cuboid(grid: Grid, count: int) -> tuple[Float[np.ndarray, "gaussian 3"], Float[np.ndarray, "3"]]:
    """Centres (x, y, z) of about `count` equal cells of a grid, and the size of a cell [mm]."""
    size = np.array(grid.shape[::-1]) * grid.spacing[::-1]
    first = np.array(grid.origin[::-1]) - np.array(grid.spacing[::-1]) / 2
    numbers = np.maximum(np.round(size * (count / size.prod()) ** (1 / 3)), 1).astype(int)
    axes = [f + (np.arange(n) + 0.5) * s / n for f, n, s in zip(first, numbers, size, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3), size / numbers
