"""The two sides of divided Gaussians as Gaussians of the same mass, centre and covariance, by torch, differentiable."""

import math
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

FARTHEST = 30.0  # standard deviations; a plane beyond counts as there, where a side has 5e-198 of the mass
LEAST_VARIANCE = 1e-4  # of a Gaussian's variance along the third axis; that of a side with next to no mass


class SideMoments(NamedTuple):
    """Moments of one side of normal distributions that are cut in two.

    Parameters
    ----------
    mass : part of the distribution on this side, 0 to 1
    mean : mean place along the third axis [standard deviations]
    spread : standard deviation along the third axis [standard deviations]
    """

    mass: Float[Tensor, " gaussian"]
    mean: Float[Tensor, " gaussian"]
    spread: Float[Tensor, " gaussian"]


def side_moments(cut: Float[Tensor, " gaussian"], above: bool) -> SideMoments:
    """Compute the moments of one side.

    Parameters
    ----------
    cut : place of the plane along the third axis [standard deviations]
    above : whether the side along the third axis is meant, else that against it

    Returns
    -------
    moments

    Notes
    -----
    A normal distribution below a has the mass Phi(a), the mean -phi(a) / Phi(a) and the variance
    1 - a phi(a) / Phi(a) - (phi(a) / Phi(a))^2 (Johnson, Kotz & Balakrishnan 1994, section 13.10).
    """
    a = (-cut if above else cut).double().clamp(-FARTHEST, FARTHEST)
    mass = torch.special.erfc(-a * math.sqrt(0.5)) / 2  # `ndtr` of torch is 0 below -8
    ratio = torch.exp(-a * a / 2) / math.sqrt(2 * math.pi) / mass
    spread = torch.sqrt((1 - a * ratio - ratio * ratio).clamp_min(LEAST_VARIANCE))
    return SideMoments(*(part.to(cut) for part in (mass, ratio if above else -ratio, spread)))
