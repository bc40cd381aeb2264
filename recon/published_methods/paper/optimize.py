"""The paper's optimisation: Adam, one random view per step, density control, and a K edge that is fitted later."""

import time
from collections.abc import Callable

import numpy as np
import torch
from jaxtyping import Float

from phantomgen.geometry.voxel_grid import Grid
from recon.gaussians.optimize import SNAPSHOTS, Progress
from recon.ops.deviance import chi_square, deviance, expected_chi_square, expected_deviance
from recon.published_methods.paper.adam import EdgeAdam, GroupedAdam, rates
from recon.published_methods.paper.density_control import PanelGradient, densify, reset_fractions
from recon.published_methods.paper.loss import total_loss
from recon.published_methods.paper.model import FactorisedGaussians, Units
from recon.published_methods.paper.projections import Projections, detector_gradient
from recon.published_methods.paper.recipe import PaperRecipe, is_due, views_in_random_order
from recon.published_methods.paper.spectral_model import SpectralModel
from spectra.threads import without_other_pools


@without_other_pools()
def fit(
    model: FactorisedGaussians,
    projections: Projections,
    spectral: SpectralModel,
    raw: tuple[tuple[str, ...], Float[np.ndarray, "raw energy"]],
    grid: Grid,
    units: Units,
    recipe: PaperRecipe,
    on_step: Callable[[Progress], bool | None] = lambda progress: None,
) -> FactorisedGaussians:
    """Run all steps of the recipe.

    Parameters
    ----------
    model : first Gaussians; they are changed
    projections : training views
    spectral : model of log projections; its K edge is changed
    raw : names of the functions in which results are given, and their values at the energies of the basis
    grid : grid of the volume
    units : units of the scene
    recipe : numbers and components
    on_step : called after every step, with deviance and chi-square of the counts of its view; the fit ends early where
        it returns True

    Returns
    -------
    the fitted model; it does not depend on the number of threads
    """
    adam = GroupedAdam(model, rates(recipe, units))
    edge = spectral.basis.edge
    edge_adam = None if edge is None or not recipe.uses("kedge-learning") else EdgeAdam(edge, recipe)
    freeze = recipe.scaled(recipe.edge_freeze) if recipe.uses("kedge-freezing") else 0
    order, rng = views_in_random_order(len(projections), recipe.seed), np.random.default_rng([recipe.seed, 3])
    panel_gradient, began = PanelGradient(len(model)), time.perf_counter()
    for step in range(1, recipe.steps + 1):
        view = projections.view(next(order))
        seen = view.seen
        for value in edge.tensors() if edge is not None else ():
            value.requires_grad_(edge_adam is not None and step > freeze)
        rendered = total_loss(model, spectral, view, grid, units, recipe, rng)
        rendered.loss.backward()
        # mean over channels, as the loss is a sum over channels and the thresholds are those of one channel
        gradient = rendered.offset.grad
        if gradient is not None:
            panel_gradient.add(detector_gradient(model.centres.detach(), gradient, view.geometry) / seen.shape[1])
        adam.step((step - 1) / max(recipe.steps - 1, 1))
        if edge_adam is not None and step > freeze:
            edge_adam.step()
        if is_due(step, recipe.densify_every, recipe) and step > recipe.scaled(recipe.densify_from):
            densify(adam, panel_gradient, grid, units, recipe, rng)
            panel_gradient = PanelGradient(len(model))
        if is_due(step, recipe.fraction_reset, recipe) and recipe.uses("fraction-reset"):
            reset_fractions(adam)
        counts = torch.from_numpy(view.counts)
        expected = torch.from_numpy(view.open_beam) * torch.exp(-rendered.log_projections.detach())
        misfit = float(deviance(counts, expected)[seen].sum() / expected_deviance(expected)[seen].sum())
        found, noise = chi_square(counts, expected), expected_chi_square(expected)
        squares, least = (torch.where(seen, x, 0).sum(dim=(0, 2, 3)).double() for x in (found, noise))
        squares = (squares / least).numpy()  # NaN for a channel that measures nothing
        gaussians = model.gaussians(units, spectral.basis.to_raw(raw[1]), raw[0])
        snapshot = step % max(recipe.steps // SNAPSHOTS, 1) == 0 or step == recipe.steps
        seconds = time.perf_counter() - began
        if on_step(Progress(step, recipe.steps, seconds, misfit, gaussians, squares, None, snapshot)):
            break
    return model
