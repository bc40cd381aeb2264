"""Settings and loop of all methods that splat: Adam, one random view per step, density control, L1 and D-SSIM."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
import torch
from jaxtyping import Bool, Float

from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from recon.published_methods.paper.adam import GroupedAdam, rates
from recon.published_methods.paper.density_control import PanelGradient, densify
from recon.published_methods.paper.loss import data_loss
from recon.published_methods.paper.model import FactorisedGaussians, Units
from recon.published_methods.paper.projections import detector_gradient
from recon.published_methods.paper.recipe import PaperRecipe, Rate, is_due, views_in_random_order
from recon.published_methods.splatting.primitives import Primitives
from recon.voxel.method import Images, Weights

REPORT_EVERY = 10  # steps; interval of reports, which compute all volumes
# components of the paper that R2-Gaussian does not have
UNUSED = ("split-threshold", "fraction-start", "fraction-reset", "image-tv")


@dataclass(frozen=True)
class Splatting:
    """Settings that all methods that splat have; all others are those of R2-Gaussian.

    Lengths and densities are in the units of `recon.published_methods.paper.recipe.PaperRecipe`.

    Parameters
    ----------
    iterations : Adam steps of each channel or basis, one view each; R2-Gaussian has 30 000, and all schedules scale
    gaussians, most : primitives of each channel or basis at the start, and largest number
    dssim : weight of structural dissimilarity
    clone_gradient : mean gradient in normalised detector coordinates that clones or splits a primitive
    pace : learning rates over those of R2-Gaussian, as fits are shorter here
    seed : seed of the first primitives, the order of views, offsets of split primitives, and patches
    """

    iterations: int = 500
    gaussians: int = 20_000
    most: int = 40_000
    dssim: float = 0.25
    clone_gradient: float = 5e-5
    pace: float = 8.0
    seed: int = 0

    @property
    def recipe(self) -> PaperRecipe:
        """All settings, those of R2-Gaussian included."""
        shared = {field.name for field in fields(PaperRecipe)}
        own = {name: value for name, value in vars(self).items() if name in shared}
        return paced(PaperRecipe(steps=self.iterations, without=UNUSED, **own), self.pace)


class Training:
    """One channel or basis: its model, its images, and the state of its optimiser.

    Parameters
    ----------
    model : first primitives
    primitives : kind of primitive
    images : log projections or line integrals [no unit]
    seen : rays that were measured
    geometry : poses of the views
    grid : grid of the volume
    units : units of this channel
    recipe : steps, rates and thresholds
    """

    def __init__(
        self,
        model: FactorisedGaussians,
        primitives: Primitives,
        images: Float[np.ndarray, "view row column"],
        seen: Bool[np.ndarray, "view row column"],
        geometry: Geometry,
        grid: Grid,
        units: Units,
        recipe: PaperRecipe,
    ) -> None:
        self.adam = GroupedAdam(model, rates(recipe, units))
        self.primitives, self.geometry, self.grid, self.units, self.recipe = primitives, geometry, grid, units, recipe
        self.images, self.seen = torch.from_numpy(images), torch.from_numpy(seen)
        self.panel_gradient, self.rng = PanelGradient(len(model)), np.random.default_rng([recipe.seed, 3])

    @property
    def model(self) -> FactorisedGaussians:
        """Primitives in their current state."""
        return self.adam.model

    def step(self, step: int, view: int) -> tuple[float, float]:
        """Make one step on one view.

        Parameters
        ----------
        step : number of the step, from 1
        view : index of the view

        Returns
        -------
        sum of squares of the residual image, and sum of squares of the image
        """
        model, recipe, unit = self.model, self.recipe, self.primitives.unit(self.units)
        geometry, image = self.geometry[view : view + 1], self.images[view][None, None]
        seen = self.seen[view][None, None]
        offset = torch.zeros_like(model.centres, requires_grad=True)
        predicted = self.primitives.images(model.centres + offset, model, self.units, geometry)
        dssim = recipe.dssim if recipe.uses("dssim") else 0.0
        loss = data_loss(predicted / unit, image / unit, seen, dssim)
        loss = loss + self.primitives.penalty(model, self.grid, self.units, recipe, self.rng)
        loss.backward()
        if offset.grad is not None:
            self.panel_gradient.add(detector_gradient(model.centres.detach(), offset.grad, geometry))
        self.adam.step((step - 1) / max(recipe.steps - 1, 1))
        if is_due(step, recipe.densify_every, recipe) and step > recipe.scaled(recipe.densify_from):
            densify(self.adam, self.panel_gradient, self.grid, self.units, recipe, self.rng)
            self.panel_gradient = PanelGradient(len(self.model))
        residual = (predicted.detach() - image)[seen]
        return float(residual.square().sum()), float(image[seen].square().sum())


def train(
    trainings: Sequence[Training | None], views: int, recipe: PaperRecipe, report: Callable[[int, float], None]
) -> None:
    """Run all steps, one step of each channel after the other, so that all channels are equally far at any time.

    Parameters
    ----------
    trainings : one per channel; None for one whose images are nowhere positive
    views : number of views
    recipe : steps and seed
    report : called every `REPORT_EVERY` steps with the step, and with ||b - A x|| / ||b|| of the steps in between
    """
    order = views_in_random_order(views, recipe.seed)
    squares, whole = 0.0, 0.0
    for step in range(1, recipe.steps + 1):
        view = next(order)
        for training in trainings:
            if training is not None:
                of_residual, of_image = training.step(step, view)
                squares, whole = squares + of_residual, whole + of_image
        if step % REPORT_EVERY == 0 or step == recipe.steps:
            report(step, (squares / whole) ** 0.5 if whole > 0 else 0.0)
            squares, whole = 0.0, 0.0


def paced(recipe: PaperRecipe, factor: float) -> PaperRecipe:
    """Multiply all learning rates of a recipe by a factor.

    Parameters
    ----------
    recipe : recipe
    factor : factor of the rates

    Returns
    -------
    recipe with these rates
    """
    rates = (recipe.centre_rate, recipe.density_rate, recipe.scale_rate, recipe.rotation_rate)
    centre, density, scale, rotation = (Rate(factor * rate.first, factor * rate.last) for rate in rates)
    return replace(recipe, centre_rate=centre, density_rate=density, scale_rate=scale, rotation_rate=rotation)


def seen_rays(images: Images, weights: Weights | None) -> Bool[np.ndarray, "view row column"]:
    """Mark the rays that were measured.

    Parameters
    ----------
    images : one image per channel or basis and view
    weights : 0 for rays that were not measured; None where all were

    Returns
    -------
    True for rays that were measured
    """
    return np.ones(images.shape[1:], bool) if weights is None else weights > 0
