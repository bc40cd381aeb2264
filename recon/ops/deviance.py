"""Deviation of measured counts from expected ones, and its mean where noise is the only cause.

Counts are Poisson distributed, but a fit allows for a model error, so that the variance is Y + (dispersion Y)^2. For
counts that follow the model exactly, deviance and chi-square are then not 1 but 1 / (1 + dispersion^2 Y) on average:
0.2 for 10,000 counts and 2 %. Users are therefore shown the sum divided by the sum of the expected values. It is 1
where noise is the only cause, for any dispersion, any counts and any weights of the counts.
"""

from functools import cache
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from scipy.stats import poisson
from torch import Tensor

LEAST = 1e-12  # counts; its square is a normal float32, so that gradients of rays without photons are finite


def deviance(
    counts: Float[Tensor, "..."], expected: Float[Tensor, "..."], dispersion: float = 0.0
) -> Float[Tensor, "..."]:
    """Compute twice the log-likelihood ratio of counts; about 1 on average if their variance is Y + (dispersion Y)^2.

    Parameters
    ----------
    counts : measured y, zeros included
    expected : modelled Y; values below `LEAST` are replaced by it, and their gradient is 0
    dispersion : relative model error; 0 gives the Poisson deviance

    Returns
    -------
    deviance of each count

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


def at_bounds(
    counts: Float[Tensor, "..."], weights: Float[Tensor, "..."], expected: Float[Tensor, "..."], dispersion: float
) -> tuple[Float[Tensor, "..."], Float[Tensor, "..."], Float[Tensor, "..."]]:
    """Compute what counts and weights are where counts are lower bounds.

    A pixel that saturates says that its counts lie between its reading and those of the open beam. So the count is that
    of the open beam, with the weight that gives it the variance of counts which are equally likely between the two,
    (open beam - reading)^2 / 12; what no other ray sees stays empty. Where a model expects fewer than the reading, the
    deviance from the reading adds to that.

    Parameters
    ----------
    counts : measured counts; those of the open beam where they are lower bounds
    weights : of the counts; minus the reading over the counts where they are lower bounds
    expected : modelled counts
    dispersion : relative model error

    Returns
    -------
    counts, weights without signs, and constants that make the deviance continuous at the readings
    """
    bound, reading = weights < 0, (-weights * counts).clamp_min(LEAST)
    missing, variance = bound & (expected < reading), counts + dispersion**2 * counts**2
    met = variance / torch.maximum((counts - reading) ** 2 / 12, variance).clamp_min(LEAST)
    both = 1 + met
    middle = (met * counts + reading) / both
    step = met * deviance(counts, reading, dispersion) - both * deviance(middle, reading, dispersion)
    found = torch.where(bound, torch.where(missing, both, met), weights)
    return torch.where(missing, middle, counts), found, torch.where(missing, step, 0.0)


def chi_square(
    counts: Float[Tensor, "..."], expected: Float[Tensor, "..."], dispersion: float = 0.0
) -> Float[Tensor, "..."]:
    """Compute (y - Y)^2 over the variance Y + (dispersion Y)^2; about 1 on average.

    Parameters
    ----------
    counts, expected : measured y and modelled Y
    dispersion : relative model error

    Returns
    -------
    chi-square of each count; variances below 1 are replaced by 1
    """
    return (counts - expected) ** 2 / (expected + (dispersion * expected) ** 2).clamp_min(1.0)


def expected_deviance(expected: Float[Tensor, "..."], dispersion: float = 0.0) -> Float[Tensor, "..."]:
    """Compute the mean of `deviance` for Poisson counts with the expectation Y, within a hundredth.

    It is the mean of the Poisson deviance, which is far below 1 where less than one count is expected and a little
    above 1 for a few counts, times 1 / (1 + dispersion^2 Y), as in `expected_chi_square`.

    Parameters
    ----------
    expected : Y
    dispersion : as in `deviance`

    Returns
    -------
    mean deviance of each count; NaN where the expectation is NaN, as in a fit that diverges
    """
    least, step, means = poisson_means()
    table = torch.from_numpy(means).to(expected)
    place = ((expected.clamp_min(least).log() - np.log(least)) / step).clamp(0, len(table) - 1.001)
    low = place.nan_to_num().long()
    mean = torch.lerp(table[low], table[low + 1], place - low)
    return torch.where(expected < least, mean * expected / least, mean) / (1 + dispersion**2 * expected)


def expected_chi_square(expected: Float[Tensor, "..."], dispersion: float = 0.0) -> Float[Tensor, "..."]:
    """Compute the mean of `chi_square` for Poisson counts with the expectation Y.

    Parameters
    ----------
    expected : Y
    dispersion : as in `chi_square`

    Returns
    -------
    mean chi-square of each count
    """
    return expected / (expected + (dispersion * expected) ** 2).clamp_min(1.0)


class PoissonMeans(NamedTuple):
    """Mean of the Poisson deviance, tabulated over the logarithm of the expectation Y.

    Parameters
    ----------
    least : Y of the first row [counts]; below it the mean is proportional to Y, and above the table it is constant
    step : difference of ln Y between two rows
    means : mean deviance of each row
    """

    least: float
    step: float
    means: Float[np.ndarray, " row"]


@cache
def poisson_means() -> PoissonMeans:
    """Tabulate the mean of the Poisson deviance from 0.001 to 1000 counts, by direct summation.

    Returns
    -------
    the table
    """
    least, most, step = 1e-3, 1e3, 0.1
    table = []
    for mean in least * np.exp(step * np.arange(round(np.log(most / least) / step) + 2)):
        counts = np.arange(int(mean + 12 * np.sqrt(mean) + 20))
        ratio = counts * np.log(np.maximum(counts, 1) / mean) - counts + mean
        table.append(float(poisson.pmf(counts, mean) @ (2 * ratio)))
    return PoissonMeans(least, step, np.array(table))
