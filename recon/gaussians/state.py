"""Everything that the steps of a fit change, so that a fit can be interrupted between two steps and go on later."""

from dataclasses import dataclass, field
from math import inf
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from recon.gaussians.adam import Adam
from recon.gaussians.divided.model_file import model_of
from recon.gaussians.model import GaussianModel

_ARRAYS = ("velocity", "inverse_curvature", "prior_metric")
_NUMBERS = ("done", "seconds", "unimproved", "sweep_deviance", "step_factor", "level", "more_views")
_LEAST = ("lowest", "last_sweep_deviance", "lowest_level")  # infinite at first, which JSON cannot express


@dataclass(eq=False)
class FitState:
    """A fit between two steps.

    Parameters
    ----------
    gaussians : the model, whose arrays require gradients
    initial : the model before the first step
    adam : means of the gradients of the model's geometry and of their squares
    velocity : last step of the coefficients, with their shape [1/mm]
    inverse_curvature : inverse blocks of the objective's curvature in the coefficients, (..., M, M) [1/mm^2]; empty
        before the first step
    prior_metric : W of the voxel prior, (M, M) [mm^2]; empty before the first step and without a prior
    done : number of steps made
    seconds : time spent on them [s]
    lowest : smallest chi-square on held-out views so far
    unimproved : number of looks at held-out views since then
    sweep_deviance : sum of the deviances of this sweep so far
    last_sweep_deviance : that sum of the whole last sweep
    step_factor : factor of the steps of the coefficients; 1 as long as no sweep raised the deviance
    level : mean logarithm of the deviance of the recent steps
    lowest_level : smallest of these so far
    more_views : factor of the views per step; more than 1 after steps that diverged
    """

    gaussians: GaussianModel
    initial: GaussianModel
    adam: Adam
    velocity: Float[Tensor, "gaussian *side basis"]
    inverse_curvature: Float[Tensor, "..."] = field(default_factory=lambda: torch.empty(0))
    prior_metric: Float[Tensor, "..."] = field(default_factory=lambda: torch.empty(0))
    done: int = 0
    seconds: float = 0.0
    lowest: float = inf
    unimproved: int = 0
    sweep_deviance: float = 0.0
    last_sweep_deviance: float = inf
    step_factor: float = 1.0
    level: float = 0.0
    lowest_level: float = inf
    more_views: int = 1

    @classmethod
    def begin(cls, start: GaussianModel) -> "FitState":
        """Make the state before the first step.

        Parameters
        ----------
        start : first guess; it is not changed

        Returns
        -------
        state with copies of the first guess
        """
        gaussians = start.detached()
        geometry = [getattr(gaussians, name).requires_grad_() for name in gaussians.GEOMETRY]
        gaussians.coefficients.requires_grad_()
        return cls(gaussians, start.detached(), Adam(geometry), torch.zeros_like(gaussians.coefficients))

    def to(self, device: torch.device) -> "FitState":
        """Copy the state to a device.

        Parameters
        ----------
        device : where steps are to be computed

        Returns
        -------
        a copy there; the state itself where it is there already
        """
        if self.velocity.device == device:
            return self
        return FitState.restore({name: value.to(device) for name, value in self.tensors().items()}, self.numbers())

    def tensors(self) -> dict[str, Tensor]:
        """Collect all arrays.

        Returns
        -------
        arrays by name, for `restore`
        """
        found = {name: value.detach() for name, value in self.gaussians.tensors().items()}
        found |= {f"{name}.initial": value for name, value in self.initial.tensors().items()}
        found |= {name: getattr(self, name) for name in _ARRAYS}
        for name, mean, square in zip(self.gaussians.GEOMETRY, self.adam.means, self.adam.squares, strict=True):
            found |= {f"{name}.mean": mean, f"{name}.square": square}
        return found

    def numbers(self) -> dict[str, Any]:
        """Collect all that is no array.

        Returns
        -------
        values that JSON takes by name, for `restore`
        """
        least = {name: None if getattr(self, name) == inf else getattr(self, name) for name in _LEAST}
        return (
            {
                "basis": list(self.gaussians.basis_names),
                "model": self.gaussians.header(),
                "initial": self.initial.header(),
            }
            | {name: getattr(self, name) for name in _NUMBERS}
            | least
        )

    @classmethod
    def restore(cls, tensors: dict[str, Tensor], numbers: dict[str, Any]) -> "FitState":
        """Make a state of its arrays and numbers.

        Parameters
        ----------
        tensors : what `FitState.tensors` gave
        numbers : what `FitState.numbers` gave

        Returns
        -------
        an equal state
        """
        names, header = tuple(numbers["basis"]), numbers.get("model", {})
        start = {name: value.clone() for name, value in tensors.items() if f"{name}.initial" in tensors}
        state = cls.begin(model_of(start, names, header))
        initial = {name: tensors[f"{name}.initial"].clone() for name in start}
        state.initial = model_of(initial, names, header | numbers.get("initial", {}))
        for name in _ARRAYS:
            setattr(state, name, tensors[name].clone())
        for name in (*_NUMBERS, *_LEAST):  # a checkpoint of an older version lacks some, which begin anew
            value = numbers.get(name, getattr(state, name))
            setattr(state, name, inf if value is None else value)
        state.adam.means = [tensors[f"{name}.mean"].clone() for name in state.gaussians.GEOMETRY]
        state.adam.squares = [tensors[f"{name}.square"].clone() for name in state.gaussians.GEOMETRY]
        return state


class InterruptedFit(NamedTuple):
    """What is kept of a fit that was interrupted.

    Parameters
    ----------
    state : where its steps stand
    volumes : volumes that it started from, (M, Z, Y, X) [1/mm]
    seconds : time of the stages before the fit, by name [s]
    """

    state: FitState
    volumes: Float[np.ndarray, "basis z y x"]
    seconds: dict[str, float]
