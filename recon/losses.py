"""How far measured counts are from expected ones."""

import torch
from jaxtyping import Float
from torch import Tensor

LEAST = 1e-12  # counts; squared it is still far from the smallest float32, so that gradients of starved rays are finite


def deviance(
    counts: Float[Tensor, "..."], expected: Float[Tensor, "..."], dispersion: float = 0.0
) -> Float[Tensor, "..."]:
    """Twice the log-likelihood ratio of counts whose variance is Y + (dispersion Y)^2; about 1 if the model is right.

    Parameters
    ----------
    counts : measured y, zeros included
    expected : modelled Y; where it is below `LEAST` it counts as that, and its gradient is 0
    dispersion : relative model error; 0 gives the Poisson deviance

    References
    ----------
    Negative binomial deviance, McCullagh & Nelder 1989, section 6.2 and 11.2, with k = dispersion^-2.
    """
    expected = expected.clamp_min(LEAST)
    ratio = torch.xlogy(counts, counts.clamp_min(LEAST) / expected)
    if dispersion == 0:
        return 2 * (ratio - counts + expected)
    k = dispersion**-2
    return 2 * (ratio - (counts + k) * torch.log((counts + k) / (expected + k)))


def chi_square(
    counts: Float[Tensor, "..."], expected: Float[Tensor, "..."], dispersion: float = 0.0
) -> Float[Tensor, "..."]:
    """(y - Y)^2 / (Y + (dispersion Y)^2), about 1 on average if the model is right; a variance below 1 counts as 1.

    Parameters
    ----------
    counts, expected : measured y and modelled Y
    dispersion : relative model error
    """
    return (counts - expected) ** 2 / (expected + (dispersion * expected) ** 2).clamp_min(1.0)
