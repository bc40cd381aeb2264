"""How far measured counts are from expected ones."""

import torch
from jaxtyping import Float
from torch import Tensor


def deviance(
    counts: Float[Tensor, "..."], expected: Float[Tensor, "..."], dispersion: float = 0.0
) -> Float[Tensor, "..."]:
    """Twice the log-likelihood ratio of counts whose variance is Y + (dispersion Y)^2; about 1 where the model is right.

    Parameters
    ----------
    counts : measured y, zeros included
    expected : modelled Y, positive
    dispersion : relative model error; 0 gives the Poisson deviance

    References
    ----------
    Negative binomial deviance, McCullagh & Nelder 1989, section 6.2 and 11.2, with k = dispersion^-2.
    """
    tiny = torch.finfo(expected.dtype).tiny
    expected = expected.clamp_min(tiny)
    ratio = torch.xlogy(counts, counts.clamp_min(tiny) / expected)
    if dispersion == 0:
        return 2 * (ratio - counts + expected)
    k = dispersion**-2
    return 2 * (ratio - (counts + k) * torch.log((counts + k) / (expected + k)))
