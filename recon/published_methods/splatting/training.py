"""The loop of all methods that splat: Adam, one random view per step, clone, split and prune; L1 and D-SSIM."""

from collections.abc import Callable, Sequence
from dataclasses import replace

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
from recon.voxel.initial_volumes import initial_volumes, starting_method
from recon.voxel.method import Images, Weights

REPORT_EVERY = 10  # steps
UNUSED = ("split-threshold", "fraction-start", "fraction-reset", "image-tv")  # parts of the paper that R2 does not have


class Training:
    """One channel or basis: its model, its images, and the state of its optimiser.

    Parameters
    ----------
    model : first primitives
    look : what they look like
    images : log projections or line integrals (view, row, column)
    seen : rays that were measured
    geometry : poses of the views
    grid : where the volume is
    units : of this channel
    recipe : steps, rates and thresholds
    """

    def __init__(
        self,
        model: FactorisedGaussians,
        look: Primitives,
        images: Float[np.ndarray, "view row column"],
        seen: Bool[np.ndarray, "view row column"],
        geometry: Geometry,
        grid: Grid,
        units: Units,
        recipe: PaperRecipe,
    ) -> None:
        self.adam = GroupedAdam(model, rates(recipe, units))
        self.look, self.geometry, self.grid, self.units, self.recipe = look, geometry, grid, units, recipe
        self.images, self.seen = torch.from_numpy(images), torch.from_numpy(seen)
        self.panel_gradient, self.rng = PanelGradient(len(model)), np.random.default_rng([recipe.seed, 3])

    @property
    def model(self) -> FactorisedGaussians:
        """The primitives as they are now."""
        return self.adam.model

    def step(self, step: int, view: int) -> tuple[float, float]:
        """One step on one view; returns squares of what was left of its image, and of the image."""
        model, recipe, unit = self.model, self.recipe, self.look.unit(self.units)
        geometry, image = self.geometry[view : view + 1], self.images[view][None, None]
        seen = self.seen[view][None, None]
        nudge = torch.zeros_like(model.centres, requires_grad=True)
        predicted = self.look.images(model.centres + nudge, model, self.units, geometry)
        dssim = recipe.dssim if recipe.uses("dssim") else 0.0
        loss = data_loss(predicted / unit, image / unit, seen, dssim)
        loss = loss + self.look.penalty(model, self.grid, self.units, recipe, self.rng)
        loss.backward()
        if nudge.grad is not None:
            self.panel_gradient.add(detector_gradient(model.centres.detach(), nudge.grad, geometry))
        self.adam.step((step - 1) / max(recipe.steps - 1, 1))
        if is_due(step, recipe.densify_every, recipe) and step > recipe.scaled(recipe.densify_from):
            densify(self.adam, self.panel_gradient, self.grid, self.units, recipe, self.rng)
            self.panel_gradient = PanelGradient(len(self.model))
        left = (predicted.detach() - image)[seen]
        return float(left.square().sum()), float(image[seen].square().sum())


def train(
    trainings: Sequence[Training | None], views: int, recipe: PaperRecipe, report: Callable[[int, float], None]
) -> None:
    """Run all steps, every channel one step after the other, so that all are equally far at any time.

    Parameters
    ----------
    trainings : one per channel; None for one that shows nothing
    views : their number
    recipe : steps and seed
    report : told the step, and ||b - A x|| over ||b|| of the steps since it was last told, every `REPORT_EVERY` steps
    """
    order = views_in_random_order(views, recipe.seed)
    left, whole = 0.0, 0.0
    for step in range(1, recipe.steps + 1):
        view = next(order)
        for training in trainings:
            if training is not None:
                squares = training.step(step, view)
                left, whole = left + squares[0], whole + squares[1]
        if step % REPORT_EVERY == 0 or step == recipe.steps:
            report(step, (left / whole) ** 0.5 if whole > 0 else 0.0)
            left, whole = 0.0, 0.0


def paced(recipe: PaperRecipe, factor: float) -> PaperRecipe:
    """A recipe whose learning rates are all times a factor."""
    rates = (recipe.centre_rate, recipe.density_rate, recipe.scale_rate, recipe.rotation_rate)
    centre, density, scale, rotation = (Rate(factor * rate.first, factor * rate.last) for rate in rates)
    return replace(recipe, centre_rate=centre, density_rate=density, scale_rate=scale, rotation_rate=rotation)


def seen_rays(images: Images, weights: Weights | None) -> Bool[np.ndarray, "view row column"]:
    """Rays that count."""
    return np.ones(images.shape[1:], bool) if weights is None else weights > 0


def first_volumes(
    images: Images, seen: Bool[np.ndarray, "view row column"], geometry: Geometry, grid: Grid
) -> Float[np.ndarray, "basis z y x"]:
    """What training starts from: filtered back-projection, or three sweeps of SART where the orbit needs it [1/mm]."""
    method = starting_method(geometry, grid)
    return initial_volumes(np.moveaxis(images, 0, 1), np.all(~seen, axis=0), geometry, grid, method)
