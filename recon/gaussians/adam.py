"""Steps of Adam (Kingma & Ba 2015, arXiv:1412.6980), with a length for each tensor.

`torch.optim.Adam` makes the same steps, bit for bit, but its first use imports torch's compiler: 1.4 s of a fit.
"""

from collections.abc import Sequence
from typing import cast

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

TINY = 1e-15  # unit of the gradient; added to the root of the mean square, so that a gradient of 0 makes no step


class Adam:
    """Means of gradients and of their squares, and the steps that follow from them.

    Parameters
    ----------
    tensors : unknowns, which steps change in place by their `grad`
    """

    def __init__(self, tensors: Sequence[Tensor]):
        self.tensors = tensors
        self.means = [torch.zeros_like(tensor) for tensor in tensors]
        self.squares = [torch.zeros_like(tensor) for tensor in tensors]

    @torch.no_grad()
    def step(
        self, lengths: Sequence[float] | Float[np.ndarray, " tensor"], number: int, decays: tuple[float, float]
    ) -> None:
        """Make one step.

        Parameters
        ----------
        lengths : length of the step of each tensor, in its unit
        number : number of this step, counted from 1
        decays : decay per step of the mean of gradients and of the mean of their squares
        """
        first, second = (1 - decay**number for decay in decays)
        for tensor, mean, square, length in zip(self.tensors, self.means, self.squares, lengths, strict=True):
            gradient = cast(Tensor, tensor.grad)
            mean.lerp_(gradient, 1 - decays[0])
            square.mul_(decays[1]).addcmul_(gradient, gradient, value=1 - decays[1])
            tensor.addcdiv_(mean, square.sqrt().div_(second**0.5).add_(TINY), value=-length / first)
