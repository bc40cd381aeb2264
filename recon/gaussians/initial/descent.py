"""Accelerated gradient steps for fits of Gaussians to volumes, whatever the Gaussians are.

Nesterov 1983; momentum is dropped where it leads uphill (O'Donoghue & Candes 2015, doi:10.1007/s10208-013-9150-3).
"""

from typing import Protocol, TypeVar, runtime_checkable

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from recon.gaussians.model import GaussianModel
from recon.gaussians.settings import VolumeFitSettings

Kind = TypeVar("Kind", bound=GaussianModel)


@runtime_checkable
class Problem(Protocol[Kind]):
    """A function of a model that `descend` lowers by steps, each in the frame of a Gaussian's own axes.

    Parameters
    ----------
    evaluations : number of times that the function was computed
    """

    evaluations: int

    def evaluate(self, model: Kind) -> tuple[float, Float[Tensor, "gaussian step"]]:
        """Compute the function, and its gradient with respect to steps.

        Parameters
        ----------
        model : where
        """
        ...

    def renew_diagonal(self, model: Kind) -> None:
        """Compute the curvature along each step, for `precondition`.

        Parameters
        ----------
        model : where
        """

    def precondition(self, gradient: Float[Tensor, "gaussian step"]) -> Float[Tensor, "gaussian step"]:
        """Divide a gradient by the curvature along each step.

        Parameters
        ----------
        gradient : with respect to steps
        """
        ...

    def held(self, model: Kind, gradient: Float[Tensor, "gaussian step"]) -> Bool[Tensor, "gaussian step"]:
        """Find the unknowns at a bound that a step against the gradient would cross.

        Parameters
        ----------
        model : where
        gradient : with respect to steps
        """
        ...

    def limited(self, step: Float[Tensor, "gaussian step"], model: Kind) -> Float[Tensor, "gaussian step"]:
        """Limit a step to lengths for which the diagonal describes the curvature.

        Parameters
        ----------
        step : as wanted
        model : where it begins
        """
        ...

    def moved(self, model: Kind, step: Float[Tensor, "gaussian step"]) -> tuple[Kind, Float[Tensor, "gaussian step"]]:
        """Make a step within the bounds, and return the step that was made as well.

        Parameters
        ----------
        model : where it begins
        step : as limited
        """
        ...


def descend(model: Kind, problem: Problem[Kind], evaluations: int, settings: VolumeFitSettings) -> Kind:
    """Lower a function of a model.

    Parameters
    ----------
    model : where to begin
    problem : the function
    evaluations : number of times that it is computed
    settings : lengths of the steps and momentum

    Returns
    -------
    the model with the lowest value found
    """
    length, since = settings.step_length, 0
    value, gradient = problem.evaluate(model)
    last, renewed = torch.zeros_like(gradient), -settings.renewal
    while problem.evaluations < evaluations:
        if problem.evaluations >= renewed + settings.renewal:
            problem.renew_diagonal(model)
            renewed = problem.evaluations
        if float((last * gradient).sum()) > 0:
            last, since = torch.zeros_like(last), 0
        held = problem.held(model, gradient)
        inertia = min(settings.momentum, since / (since + 3))  # Nesterov's sequence for convex functions
        wanted = inertia * last - length * problem.precondition(gradient.masked_fill(held, 0))
        ahead, step = problem.moved(model, problem.limited(wanted.masked_fill(held, 0), model))
        there, slope = problem.evaluate(ahead)
        if there > settings.rise * value:
            last, since, length = torch.zeros_like(last), 0, settings.shortening * length
            continue
        model, value, gradient, last, since = ahead, there, slope, step, since + 1
    return model
