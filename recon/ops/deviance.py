"""How far measured counts are from expected ones, and how far noise alone would bring them.

Counts are Poisson distributed, but a fit concedes a model error, so that its variance is Y + (dispersion Y)^2. Of
counts that follow the model exactly, deviance and chi-square are then not 1 but 1 / (1 + dispersion^2 Y) on average:
0.2 for 10,000 counts and 2 %. What is shown to users is therefore the sum over that of its expected values, and 1
is what noise alone would leave, whatever the dispersion, the counts, and the say that each of them has.
"""

from functools import cache

import numpy as np
import torch
from jaxtyping import Float
from scipy.stats import poisson
from torch import Tensor

LEAST = 1e-12  # counts; squared it is still far from the smallest float32, so that gradients of starved rays are finite


def deviance(
    counts: Float[Tensor, "..."], expected: Float[Tensor, "..."], dispersion: float = 0.0
) -> Float[Tensor, "..."]:
    """Twice the log-likelihood ratio of counts whose variance is Y + (dispersion Y)^2; about 1 if it is.

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
    """(y - Y)^2 / (Y + (dispersion Y)^2), about 1 on average if that is the variance; one below 1 counts as 1.

    Parameters
    ----------
    counts, expected : measured y and modelled Y
    dispersion : relative model error
    """
    return (counts - expected) ** 2 / (expected + (dispersion * expected) ** 2).clamp_min(1.0)


def expected_deviance(expected: Float[Tensor, "..."], dispersion: float = 0.0) -> Float[Tensor, "..."]:
    """Mean of `deviance` of Poisson counts whose expectation the model knows, within a hundredth.

    That of the Poisson deviance, which is far below 1 for less than a count and a little above for a few, times
    1 / (1 + dispersion^2 Y), as in `expected_chi_square`.

    Parameters
    ----------
    expected, dispersion : as of `deviance`
    """
    table = torch.from_numpy(_poisson_table()).to(expected)
    place = ((expected.clamp_min(_LOW).log() - np.log(_LOW)) / _STEP).clamp(0, len(table) - 1.001)
    low = place.long()
    mean = torch.lerp(table[low], table[low + 1], place - low)
    return torch.where(expected < _LOW, mean * expected / _LOW, mean) / (1 + dispersion**2 * expected)


def expected_chi_square(expected: Float[Tensor, "..."], dispersion: float = 0.0) -> Float[Tensor, "..."]:
    """Mean of `chi_square` of Poisson counts whose expectation the model knows.

    Parameters
    ----------
    expected, dispersion : as of `chi_square`
    """
    return expected / (expected + (dispersion * expected) ** 2).clamp_min(1.0)


_LOW, _HIGH, _STEP = 1e-3, 1e3, 0.1  # counts, and the step of their logarithm, between which the mean is tabulated


@cache
def _poisson_table() -> Float[np.ndarray, " step"]:
    """Means of the Poisson deviance, by direct summation."""
    means = _LOW * np.exp(_STEP * np.arange(round(np.log(_HIGH / _LOW) / _STEP) + 2))
    table = []
    for mean in means:
        counts = np.arange(int(mean + 12 * np.sqrt(mean) + 20))
        ratio = counts * np.log(np.maximum(counts, 1) / mean) - counts + mean
        table.append(float(poisson.pmf(counts, mean) @ (2 * ratio)))
    return np.array(table)
