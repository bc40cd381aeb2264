"""Everything that steps of a fit change, so that a fit can be put down and taken up again without a trace."""

from dataclasses import dataclass, field
from math import inf
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from recon.gaussians.adam import Adam
from recon.gaussians.model import PARTS, Gaussians

GEOMETRY = ("centres", "log_scales", "quaternions")


_NUMBERS = ("done", "seconds", "unimproved", "sweep", "restraint")
_LEAST = ("lowest", "last_sweep")  # infinite at first, which JSON does not know


@dataclass(eq=False)
class FitState:
    """A fit between two steps.

    Parameters
    ----------
    gaussians : the model, whose tensors require gradients
    begun : the model before the first step
    adam : means of the gradients of `GEOMETRY` and of their squares
    velocity : last step of the coefficients [1/mm]
    inverse : inverse blocks of the coefficients' curvature; empty before the first step
    weight : of the prior, see `recon.gaussians.voxel_prior`; empty before the first step
    done : steps made
    seconds : spent on them
    lowest : smallest chi-square on held-out rays so far
    unimproved : snapshots since then
    sweep, last_sweep : sum of the deviances of this sweep over the views so far, and that of the whole last one
    restraint : of the steps of the coefficients, 1 where they have led nowhere worse
    """

    gaussians: Gaussians
    begun: Gaussians
    adam: Adam
    velocity: Float[Tensor, "gaussian basis"]
    inverse: Float[Tensor, "..."] = field(default_factory=lambda: torch.empty(0))
    weight: Float[Tensor, "..."] = field(default_factory=lambda: torch.empty(0))
    done: int = 0
    seconds: float = 0.0
    lowest: float = inf
    unimproved: int = 0
    sweep: float = 0.0
    last_sweep: float = inf
    restraint: float = 1.0

    @classmethod
    def begin(cls, start: Gaussians) -> "FitState":
        """Before the first step; `start` is left as it is."""
        gaussians = start.detached()
        geometry = [getattr(gaussians, name).requires_grad_() for name in GEOMETRY]
        gaussians.coefficients.requires_grad_()
        return cls(gaussians, start.detached(), Adam(geometry), torch.zeros_like(gaussians.coefficients))

    def to(self, device: torch.device) -> "FitState":
        """The same on a device; this one where it is there."""
        if self.velocity.device == device:
            return self
        return FitState.restore({name: value.to(device) for name, value in self.tensors().items()}, self.numbers())

    def tensors(self) -> dict[str, Tensor]:
        """All arrays by name."""
        found = {name: value.detach() for name, value in self.gaussians.tensors().items()}
        found |= {f"{name}.begun": value for name, value in self.begun.tensors().items()}
        found |= {"velocity": self.velocity, "inverse": self.inverse, "weight": self.weight}
        for name, mean, square in zip(GEOMETRY, self.adam.means, self.adam.squares, strict=True):
            found |= {f"{name}.mean": mean, f"{name}.square": square}
        return found

    def numbers(self) -> dict[str, Any]:
        """All else, for JSON."""
        least = {name: None if getattr(self, name) == inf else getattr(self, name) for name in _LEAST}
        return {"basis": list(self.gaussians.basis_names)} | {name: getattr(self, name) for name in _NUMBERS} | least

    @classmethod
    def restore(cls, tensors: dict[str, Tensor], numbers: dict[str, Any]) -> "FitState":
        """From what `tensors` and `numbers` gave."""
        names = tuple(numbers["basis"])
        state = cls.begin(Gaussians(*(tensors[name] for name in PARTS), basis_names=names))
        state.begun = Gaussians(*(tensors[f"{name}.begun"].clone() for name in PARTS), basis_names=names)
        state.velocity, state.inverse, state.weight = (
            tensors[name].clone() for name in ("velocity", "inverse", "weight")
        )
        for name in _NUMBERS:
            setattr(state, name, numbers[name])
        for name in _LEAST:
            setattr(state, name, inf if numbers[name] is None else numbers[name])
        state.adam.means = [tensors[f"{name}.mean"].clone() for name in GEOMETRY]
        state.adam.squares = [tensors[f"{name}.square"].clone() for name in GEOMETRY]
        return state
