"""Limited-memory BFGS: what past steps say about the curvature of a function."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

import torch
from torch import Tensor

MEMORY = 8  # steps that are remembered
_FLAT = 1e-10  # cosine between a step and the change of the gradient below which it says nothing

_Pair = tuple[Tensor, Tensor, float]  # a step, the change of the gradient, and their inner product


@dataclass
class History:
    """The last steps, and how the gradient changed in each."""

    pairs: deque[_Pair] = field(default_factory=lambda: deque(maxlen=MEMORY))

    def add(self, step: Tensor, change: Tensor) -> None:
        """Remember a step and the change of the gradient, unless the function bends downwards along it."""
        bend = _dot(step, change)
        if bend > _FLAT * (_dot(step, step) * _dot(change, change)) ** 0.5:
            self.pairs.append((step, change, bend))

    def solve(self, gradient: Tensor, precondition: Callable[[Tensor], Tensor], scale: float) -> Tensor:
        """Inverse curvature times a gradient, by the two loops of Nocedal & Wright 2006, algorithm 7.4.

        Parameters
        ----------
        gradient : to be multiplied
        precondition : a positive definite guess of the inverse curvature, up to a factor, times a vector
        scale : that factor, while nothing is remembered
        """
        rest, shares = gradient, []
        for step, change, bend in reversed(self.pairs):
            share = _dot(step, rest) / bend
            rest = torch.sub(rest, change, alpha=share)
            shares.append(share)
        if self.pairs:
            _, change, bend = self.pairs[-1]
            scale = bend / _dot(change, precondition(change))
        out = scale * precondition(rest)
        for (step, change, bend), share in zip(self.pairs, reversed(shares), strict=True):
            out = torch.add(out, step, alpha=share - _dot(change, out) / bend)
        return out


def _dot(a: Tensor, b: Tensor) -> float:
    """Inner product; rows are summed in their own precision, which is six times as fast."""
    return float((a * b).sum(dim=-1).sum(dtype=torch.float64))
