"""Adaptive density control: clone and split Gaussians with a large gradient, remove empty ones, reset fractions.

This is the strategy of R2-Gaussian (Zha et al. 2024, arXiv:2405.20693), with a gradient threshold of its own for
splitting (table 4c of the paper).
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

SHRINK = 1.6  # no unit; standard deviation of a split Gaussian over that of its parts; R2-Gaussian


class PanelGradient:
    """Mean gradient in normalised detector coordinates over the views in which a Gaussian is visible.

    Parameters
    ----------
    count : number of Gaussians
    """

    def __init__(self, count: int) -> None:
        self.total, self.views = torch.zeros(count), torch.zeros(count)

    def add(self, gradient: Float[Tensor, " gaussian"]) -> None:
        """Add the gradients of one view.

        Parameters
        ----------
        gradient : length of the gradient in normalised detector coordinates; exactly 0 where a Gaussian is not visible
        """
        self.total += gradient
        self.views += gradient > 0

    def mean(self) -> Float[Tensor, " gaussian"]:
        """Compute the mean over the views that were added.

        Returns
        -------
        mean gradient per Gaussian; 0 for one that was never visible
        """
        return self.total / self.views.clamp_min(1)


@dataclass(frozen=True)
class Choice:
    """Gaussians to clone and Gaussians to split.

    Parameters
    ----------
    clone : True for Gaussians to clone
    split : True for Gaussians to split; none is in both
    """

    clone: Bool[Tensor, " gaussian"]
    split: Bool[Tensor, " gaussian"]


def choose(
    panel_gradient: Float[Tensor, " gaussian"], sigma: Float[Tensor, "gaussian 3"], edge: float, recipe: PaperRecipe
) -> Choice:
    """Choose small Gaussians with a large gradient to be cloned, and large ones to be split.

    Parameters
    ----------
    panel_gradient : mean gradient, see `PanelGradient`
    sigma : standard deviations [mm]
    edge : longest edge of the grid [mm]
    recipe : thresholds, and the largest number of Gaussians

    Returns
    -------
    the choice; those with the largest gradients where the number of Gaussians is limited
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
    """Clone, split and remove the Gaussians of an optimiser.

    Parameters
    ----------
    adam : optimiser, whose model is changed
    panel_gradient : gradients since the last call
    grid : grid of the volume; Gaussians whose centres are outside are removed
    units : units of the scene
    recipe : thresholds and components
    rng : random numbers for the centres of split Gaussians
    """
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
    """Average all fractions with equal ones, so that none stays so close to 0 that its gradient vanishes.

    Parameters
    ----------
    adam : optimiser, whose model is changed
    """
    fractions = adam.model.material_fractions()
    adam.overwrite("fractions", torch.log((fractions + 1 / fractions.shape[1]) / 2))


def _rows(model: FactorisedGaussians, some: Bool[Tensor, " gaussian"]) -> dict[str, Tensor]:
    """Parameters of some Gaussians by name, as copies."""
    return {name: values[some].clone() for name, values in model.tensors().items()}


def _halves(
    model: FactorisedGaussians, some: Bool[Tensor, " gaussian"], units: Units, rng: np.random.Generator
) -> dict[str, Tensor]:
    """Parameters of smaller Gaussians of half the density, at random points drawn from the given ones."""
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
    """True for Gaussians of nearly no density, or with their centre outside the grid."""
    spacing, origin = torch.tensor(grid.spacing[::-1]), torch.tensor(grid.origin[::-1])
    voxel = (centres - origin) / spacing
    outside = ((voxel < -0.5) | (voxel > torch.tensor(grid.shape[::-1]) - 0.5)).any(dim=1)
    return outside | (torch.nn.functional.softplus(densities)[:, 0] < recipe.least_density)
