"""Adaptive density control: clone and split where the gradient is large, prune what is empty, reset fractions.

R2-Gaussian's strategy, with a gradient threshold of its own for splitting.
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation
from torch import Tensor

from phantomgen.geometry.voxel_grid import Grid
from recon.published_methods.paper.adam import GroupedAdam
from recon.published_methods.paper.model import FactorisedGaussians, Units, inverse_bounded, inverse_softplus
from recon.published_methods.paper.recipe import PaperRecipe

SHRINK = 1.6  # a split Gaussian's standard deviations over those of its halves


class PanelGradient:
    """Mean gradient in normalised detector coordinates, over the views in which a Gaussian was seen."""

    def __init__(self, count: int) -> None:
        self.total, self.views = torch.zeros(count), torch.zeros(count)

    def add(self, gradient: Float[Tensor, " gaussian"]) -> None:
        """Gradients of one view; those of exactly 0 were not seen."""
        self.total += gradient
        self.views += gradient > 0

    def mean(self) -> Float[Tensor, " gaussian"]:
        """Mean per view."""
        return self.total / self.views.clamp_min(1)


@dataclass(frozen=True)
class Choice:
    """What is to happen to which Gaussians."""

    clone: Bool[Tensor, " gaussian"]
    split: Bool[Tensor, " gaussian"]


def choose(
    panel_gradient: Float[Tensor, " gaussian"], sigma: Float[Tensor, "gaussian 3"], edge: float, recipe: PaperRecipe
) -> Choice:
    """Small Gaussians that are pulled at are cloned, large ones split, the strongest first if there is no room for all.

    Parameters
    ----------
    panel_gradient : mean gradient, see `PanelGradient`
    sigma : standard deviations [mm]
    edge : longest edge of the grid [mm]
    recipe : thresholds, and how many Gaussians there may be
    """
    large = sigma.max(dim=1).values > recipe.large * edge
    threshold = recipe.split_gradient if recipe.uses("split-threshold") else recipe.clone_gradient
    over = panel_gradient >= torch.where(large, threshold, recipe.clone_gradient)
    room = max(recipe.most - len(panel_gradient), 0)
    if int(over.sum()) > room:
        strongest = torch.argsort(torch.where(over, panel_gradient, 0.0), descending=True, stable=True)[:room]
        over = torch.zeros_like(over).index_fill_(0, strongest, True)
    return Choice(over & ~large, over & large)


@torch.no_grad()
def densify(
    adam: GroupedAdam,
    panel_gradient: PanelGradient,
    grid: Grid,
    units: Units,
    recipe: PaperRecipe,
    rng: np.random.Generator,
) -> None:
    """Clone, split and prune the Gaussians of an optimiser."""
    model = adam.model
    none = torch.zeros(len(model), dtype=torch.bool)
    choice = Choice(none, none)
    if recipe.uses("densification"):
        choice = choose(panel_gradient.mean(), model.sigma(units), 2 * units.length, recipe)
    halved = torch.where(choice.clone[:, None], inverse_softplus(model.density() / 2), model.densities)
    model.densities.copy_(halved)
    added = [_rows(model, choice.clone), *(_halves(model, choice.split, units, rng) for _ in range(2))]
    rows = {name: torch.cat([part[name] for part in added]) for name in model.tensors()}
    kept = ~choice.split
    if recipe.uses("pruning"):
        kept &= ~_empty(model.densities, model.centres, grid, recipe)
        alive = ~_empty(rows["densities"], rows["centres"], grid, recipe)
        rows = {name: values[alive] for name, values in rows.items()}
    adam.replace_rows(torch.nonzero(kept)[:, 0], rows)


@torch.no_grad()
def reset_fractions(adam: GroupedAdam) -> None:
    """Draw all fractions half way to equal ones, so that none stays too close to 0 to be moved by the gradient."""
    fractions = adam.model.material_fractions()
    adam.overwrite("fractions", torch.log((fractions + 1 / fractions.shape[1]) / 2))


def _rows(model: FactorisedGaussians, some: Bool[Tensor, " gaussian"]) -> dict[str, Tensor]:
    return {name: values[some].clone() for name, values in model.tensors().items()}


def _halves(
    model: FactorisedGaussians, some: Bool[Tensor, " gaussian"], units: Units, rng: np.random.Generator
) -> dict[str, Tensor]:
    """Smaller Gaussians of half the density at random places inside the given ones."""
    rows = _rows(model, some)
    sigma = model.sigma(units)[some]
    offsets = sigma.numpy() * rng.standard_normal(sigma.shape)
    if len(sigma):
        offsets = Rotation.from_quat(rows["quaternions"].numpy()[:, [1, 2, 3, 0]]).apply(offsets)
    rows["centres"] += torch.from_numpy(offsets).float()
    rows["scales"] = inverse_bounded(torch.clamp(sigma / SHRINK, min=units.narrowest), units)
    rows["densities"] = inverse_softplus(model.density()[some] / 2)
    return rows


def _empty(
    densities: Float[Tensor, "gaussian 1"], centres: Float[Tensor, "gaussian 3"], grid: Grid, recipe: PaperRecipe
) -> Bool[Tensor, " gaussian"]:
    """Which Gaussians have no density, or left the grid."""
    spacing, origin = torch.tensor(grid.spacing[::-1]), torch.tensor(grid.origin[::-1])
    voxel = (centres - origin) / spacing
    outside = ((voxel < -0.5) | (voxel > torch.tensor(grid.shape[::-1]) - 0.5)).any(dim=1)
    return outside | (torch.nn.functional.softplus(densities)[:, 0] < recipe.least_density)
