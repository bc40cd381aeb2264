"""One set of Gaussians per channel, monochromatic: R2-Gaussian (Zha et al. 2024, arXiv:2405.20693).

Local-affine footprints with its integration factor, softplus densities, bounded standard deviations, a start from
filtered back-projection, L1, structural dissimilarity and the total variation of random pieces, clone, split and prune.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from recon.published_methods.paper.initialize import first_gaussians, units_of
from recon.published_methods.paper.recipe import PaperRecipe
from recon.published_methods.splatting.primitives import Attenuation, VolumePrimitives
from recon.published_methods.splatting.training import UNUSED, Training, first_volumes, paced, seen_rays, train
from recon.voxel.method import Images, Iteration, OnIteration, Volumes, Weights, unwatched
from spectra.threads import without_other_pools


@dataclass(frozen=True)
class GaussianMono:
    """R2-Gaussian as a method.

    Lengths and densities are in the units of `recon.published_methods.paper.recipe.PaperRecipe`.

    Parameters
    ----------
    iterations : Adam steps of each channel, one view each; R2-Gaussian's 30 000, and all of its schedules, scale
    gaussians, most : of each channel at the start, and at most
    density_share : density of a Gaussian over that of its voxel at the start
    dssim, volume_tv : weights of structural dissimilarity and of the total variation
    patch : edge of those pieces [voxel]; R2-Gaussian's 32 takes half of the time
    clone_gradient : mean gradient on the panel that clones or splits a Gaussian
    pace : learning rates over those of R2-Gaussian, as fits are shorter here
    seed : of the first Gaussians, the order of views, split offsets and pieces
    """

    iterations: int = 500
    gaussians: int = 20_000
    most: int = 40_000
    density_share: float = 0.15
    dssim: float = 0.25
    volume_tv: float = 0.05
    patch: int = 16
    clone_gradient: float = 5e-5
    pace: float = 8.0
    seed: int = 0

    @property
    def name(self) -> str:
        """What ``--method`` calls it."""
        return "gaussian-mono"

    @property
    def recipe(self) -> PaperRecipe:
        """All numbers."""
        recipe = PaperRecipe(
            steps=self.iterations, without=UNUSED, seed=self.seed, gaussians=self.gaussians, most=self.most,
            density_share=self.density_share, dssim=self.dssim, volume_tv=self.volume_tv, patch=self.patch,
            clone_gradient=self.clone_gradient,
        )  # fmt: skip
        return paced(recipe, self.pace)

    def reconstruct(
        self,
        line_integrals: Images,
        weights: Weights | None,
        geometry: Geometry,
        grid: Grid,
        on_iteration: OnIteration = unwatched,
    ) -> Volumes:
        """See `recon.voxel.method.LinearMethod`."""
        return splat(line_integrals, weights, geometry, grid, Attenuation(), self.recipe, on_iteration)


@without_other_pools()
def splat(
    images: Images,
    weights: Weights | None,
    geometry: Geometry,
    grid: Grid,
    look: VolumePrimitives,
    recipe: PaperRecipe,
    on_iteration: OnIteration = unwatched,
) -> Volumes:
    """Volumes [1/mm] of images [no unit], from primitives at voxels of a first reconstruction.

    Parameters
    ----------
    images : one per channel or basis and view
    weights : how much each ray counts: nothing at 0, all alike above
    geometry : poses of the views
    grid : the volume to reconstruct
    look : kind of primitive
    recipe : numbers
    on_iteration : called every few steps
    """
    seen = seen_rays(images, weights)
    starts = first_volumes(images, seen, geometry, grid)
    trainings = [
        _begin(start, image, seen, geometry, grid, look, recipe) for start, image in zip(starts, images, strict=True)
    ]

    def volumes() -> Float[np.ndarray, "basis z y x"]:
        nothing = np.zeros(grid.shape, np.float32)
        return np.stack([nothing if t is None else look.volume(t.model, t.units, grid) for t in trainings])

    def report(step: int, residual: float) -> None:
        on_iteration(Iteration(step, recipe.steps, residual, volumes()))

    train(trainings, len(geometry), recipe, report)
    return volumes()


def _begin(
    start: Float[np.ndarray, "z y x"],
    images: Float[np.ndarray, "view row column"],
    seen: np.ndarray,
    geometry: Geometry,
    grid: Grid,
    look: VolumePrimitives,
    recipe: PaperRecipe,
) -> Training | None:
    """Primitives at the voxels of a start; None where it is nowhere positive."""
    if not (start > 0).any():
        return None
    units = units_of(start, grid, recipe)
    model = first_gaussians(start, grid, np.ones(1), units, recipe)
    return Training(model, look, images, seen, geometry, grid, units, recipe)
