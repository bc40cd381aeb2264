"""Adam with a learning rate per group of parameters, for models whose number of rows changes."""

import torch
from torch import Tensor

from recon.published_methods.paper.learned_edge import KEdge
from recon.published_methods.paper.model import FactorisedGaussians, Units
from recon.published_methods.paper.recipe import PaperRecipe, Rate

# no unit; constant of Adam that avoids division by zero; R2-Gaussian
EPSILON = 1e-15


def rates(recipe: PaperRecipe, units: Units) -> dict[str, Rate]:
    """Return the learning rate of each parameter of the Gaussians.

    Parameters
    ----------
    recipe : rates, and the components that change them
    units : units of the scene

    Returns
    -------
    rates by the names of `FactorisedGaussians`; that of the centres in mm
    """
    centre = Rate(recipe.centre_rate.first * units.length, recipe.centre_rate.last * units.length)
    fraction = recipe.fraction_rate if recipe.uses("fraction-rate") else recipe.density_rate
    found = {
        "centres": centre,
        "densities": recipe.density_rate,
        "scales": recipe.scale_rate,
        "quaternions": recipe.rotation_rate,
        "fractions": fraction,
    }
    if recipe.uses("rate-decay"):
        return found
    return {name: Rate(rate.first, rate.first) for name, rate in found.items()}


class GroupedAdam:
    """Adam on the parameters of a model.

    Parameters
    ----------
    model : model to optimise; its tensors are replaced when rows are added or removed
    rates : learning rate of each parameter
    """

    def __init__(self, model: FactorisedGaussians, rates: dict[str, Rate]) -> None:
        self.model, self.rates = model, rates
        for name, value in model.tensors().items():
            setattr(model, name, value.detach().clone().requires_grad_())
        groups = [{"params": [value], "name": name} for name, value in model.tensors().items()]
        self.adam = torch.optim.Adam(groups, lr=1.0, eps=EPSILON)

    def step(self, fraction: float) -> None:
        """Make one step of Adam, and clear the gradients.

        Parameters
        ----------
        fraction : part of the fit that is done, 0 to 1, which sets the learning rates
        """
        for group in self.adam.param_groups:
            rate = self.rates[group["name"]]
            group["lr"] = rate.first * (rate.last / rate.first) ** fraction
        self.adam.step()
        self.adam.zero_grad()

    def replace_rows(self, kept: Tensor, added: dict[str, Tensor]) -> None:
        """Keep some rows with their moments, and append new rows with moments of zero.

        Parameters
        ----------
        kept : indices of the rows to keep
        added : new rows of each parameter
        """
        for group in self.adam.param_groups:
            name = group["name"]
            old = group["params"][0]
            new = torch.cat([old.detach()[kept], added[name]]).requires_grad_()
            state = self.adam.state.pop(old, {})
            for moment in ("exp_avg", "exp_avg_sq"):
                if moment in state:
                    state[moment] = torch.cat([state[moment][kept], torch.zeros_like(added[name])])
            self.adam.state[new] = state
            group["params"][0] = new
            setattr(self.model, name, new)

    def overwrite(self, name: str, values: Tensor) -> None:
        """Set the values of a parameter, and set its moments to zero.

        Parameters
        ----------
        name : name of the parameter
        values : new values
        """
        parameter = getattr(self.model, name)
        parameter.detach().copy_(values)
        for moment in ("exp_avg", "exp_avg_sq"):
            if moment in self.adam.state[parameter]:
                self.adam.state[parameter][moment].zero_()


class EdgeAdam:
    """Adam for the K edge, whose energy stays between the limits of the energy grid.

    Parameters
    ----------
    edge : edge to optimise
    recipe : learning rates and the limits of the energy
    """

    def __init__(self, edge: KEdge, recipe: PaperRecipe) -> None:
        self.edge, self.lowest, self.highest = edge, recipe.lowest_energy, recipe.highest_energy
        for value in edge.tensors():
            value.requires_grad_()
        shape = [edge.log_slope, edge.log_amplitude]
        groups = [{"params": [edge.energy], "lr": recipe.edge_rate}, {"params": shape, "lr": recipe.edge_shape_rate}]
        self.adam = torch.optim.Adam(groups)

    def step(self) -> None:
        """Make one step of Adam, and clear the gradients."""
        self.adam.step()
        self.adam.zero_grad()
        self.edge.energy.detach().clamp_(self.lowest, self.highest)
