"""Steps of Adam (Kingma and Ba, 2015), a rate for each tensor.

`torch.optim.Adam` makes the same steps, bit for bit, but its first use imports torch's compiler: 1.4 s of a fit.
"""

from collections.abc import Sequence
from typing import cast

import numpy as np
import torch
from torch import Tensor

DECAY = 0.9, 0.99  # of the means of gradients and of their squares
TINY = 1e-15


class Adam:
    """Means of gradients and of their squares.

    Parameters
    ----------
    tensors : that steps change in place, by their `grad`
    """

    def __init__(self, tensors: Sequence[Tensor]):
        self.tensors = tensors
        self.means = [torch.zeros_like(tensor) for tensor in tensors]
        self.squares = [torch.zeros_like(tensor) for tensor in tensors]

    @torch.no_grad()
    def step(self, rates: Sequence[float] | np.ndarray, number: int) -> None:
        """One step; `number` counts them from 1."""
        first, second = (1 - decay**number for decay in DECAY)
        for tensor, mean, square, rate in zip(self.tensors, self.means, self.squares, rates, strict=True):
            gradient = cast(Tensor, tensor.grad)
            mean.lerp_(gradient, 1 - DECAY[0])
            square.mul_(DECAY[1]).addcmul_(gradient, gradient, value=1 - DECAY[1])
            tensor.addcdiv_(mean, square.sqrt().div_(second**0.5).add_(TINY), value=-rate / first)
