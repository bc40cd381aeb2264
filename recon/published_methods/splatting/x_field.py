"""Hard ellipsoids with chord lengths, after X-Field (Wang et al. 2025, arXiv:2503.08596).

Each ellipsoid has one attenuation per channel, and a ray takes that times its chord: `recon.ops.chords` says what is
smoothed at outlines, where chords have no gradient. Simplified: attenuations add up where ellipsoids overlap, in the
place of an order of precedence; the start is a filtered back-projection, and clone, split and prune are those of
R2-Gaussian, in the place of progressive and material-based steps. There is a volume to read, without one more
reconstruction from rendered views.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from recon.ops.chords import chords, fill
from recon.published_methods.paper.model import FactorisedGaussians, Units
from recon.published_methods.paper.recipe import PaperRecipe
from recon.published_methods.splatting.primitives import Image
from recon.published_methods.splatting.r2_gaussian import splat
from recon.published_methods.splatting.training import UNUSED, paced
from recon.voxel.method import Images, OnIteration, Volumes, Weights, unwatched

RADII = math.sqrt(5)  # semi-axes over standard deviations of the Gaussian with the same second moments


@dataclass(frozen=True)
class Chords:
    """Ellipsoids of constant attenuation that have the second moments of the model's Gaussians."""

    def unit(self, units: Units) -> float:
        """See `recon.published_methods.splatting.primitives.Primitives`."""
        return units.line_integral

    def images(
        self, centres: Float[Tensor, "gaussian 3"], model: FactorisedGaussians, units: Units, geometry: Geometry
    ) -> Image:
        """See `recon.published_methods.splatting.primitives.Primitives`."""
        parts = (centres, _log_axes(model, units), model.quaternions, units.density * model.density())
        return chords(*parts, torch.from_numpy(geometry.ray_frames()), geometry.panel.rows, geometry.panel.columns)

    def penalty(
        self, model: FactorisedGaussians, grid: Grid, units: Units, recipe: PaperRecipe, rng: np.random.Generator
    ) -> float:
        """Nothing: hard ellipsoids give a total variation no gradient."""
        return 0.0

    def volume(self, model: FactorisedGaussians, units: Units, grid: Grid) -> Float[np.ndarray, "z y x"]:
        """See `recon.published_methods.splatting.primitives.VolumePrimitives`."""
        inside = units.density * model.density()[:, 0]
        return fill(model.centres, _log_axes(model, units), model.quaternions, inside, grid)


@dataclass(frozen=True)
class Ellipsoid:
    """Hard ellipsoids as a method; other numbers are those of `recon.published_methods.splatting.r2_gaussian`.

    Parameters
    ----------
    iterations : Adam steps of each channel, one view each
    gaussians, most : ellipsoids of each channel at the start, and at most
    density_share : attenuation of an ellipsoid over that of its voxel at the start
    dssim : weight of structural dissimilarity
    clone_gradient : mean gradient on the panel that clones or splits an ellipsoid
    pace : learning rates over those of R2-Gaussian
    seed : of the first ellipsoids, the order of views and split offsets
    """

    iterations: int = 500
    gaussians: int = 20_000
    most: int = 40_000
    density_share: float = 0.06
    dssim: float = 0.25
    clone_gradient: float = 5e-5
    pace: float = 8.0
    seed: int = 0

    @property
    def name(self) -> str:
        """What ``--method`` calls it."""
        return "ellipsoid"

    @property
    def recipe(self) -> PaperRecipe:
        """All numbers."""
        recipe = PaperRecipe(
            steps=self.iterations, without=UNUSED, seed=self.seed, gaussians=self.gaussians, most=self.most,
            density_share=self.density_share, dssim=self.dssim, clone_gradient=self.clone_gradient,
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
        return splat(line_integrals, weights, geometry, grid, Chords(), self.recipe, on_iteration)


def _log_axes(model: FactorisedGaussians, units: Units) -> Float[Tensor, "gaussian 3"]:
    """Logarithm of the semi-axes [log mm]."""
    return model.log_scales(units) + math.log(RADII)
