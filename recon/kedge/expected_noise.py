"""Effect of noise and of a conceded misfit on the drop in deviance that a further function gives on one ray.

Deviances weigh channels by W = 1 / (Y + (eta Y)^2), which concedes a model error of eta, while counts have the variance
V = Y. With S = W^1/2 dY/dL of the smaller basis, s that of the further function, and t the part of s that S cannot
give, the drop is u^2 with

    u = t . W^1/2 (y - Y) / |t|,    var u = sum_c t_c^2 W_c V_c / |t|^2 = q <= 1.

Line integrals of the function must not be negative, so noise alone gives a drop of 0 or, as often, q times chi-square
with one degree of freedom (Self & Liang 1987, doi:10.1080/01621459.1987.10478472, case 5): mean q / 2, variance
5 q^2 / 4. Likelihoods whose variance is not that of the data give such scaled laws (White 1982, doi:10.2307/1912526;
Kent 1982, doi:10.1093/biomet/69.1.19). For eta = 0, q is 1.

Where expected counts err by a part `MISFIT` of theirs, in any channels and of any sign, u moves by at most

    b = MISFIT sum_c |t_c| W_c^1/2 Y_c / |t|,

so that max(u - b, 0)^2 of such a misfit and noise is not larger, on average and in spread, than u^2 of noise alone.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from recon.kedge.edge_likelihood import EdgeLikelihood, Functions
from spectra.basis.basis import BasisFunction

# Relative error of expected counts, in any channel, that is not taken for a K edge: twice the most that scans without
# an edge need for a score below 5. Six such scans with the source and detector of `contrast-vials` (PMMA; bone in
# water; aluminium of 30 and 40 mm; PMMA with aluminium, steel, calcium and bone; thin rods), of 4e5 and 4e6 photons,
# judged for I, Gd and Au, need 0.10 % at most (aluminium of 40 mm, Au): `python -m
# benchmarks.reconstruction.kedge_presets`. What errs there: simulated counts are exact to 0.1 %, and thickness varies
# within pixels that are joined.
MISFIT = 2e-3


@dataclass(frozen=True, eq=False)
class NullDistribution:
    """Distribution of u of each ray that does not need the further function.

    Parameters
    ----------
    variance : variance q of u from noise alone [no unit]
    shift : largest shift b of u by a conceded misfit [no unit]
    """

    variance: Float[np.ndarray, " ray"]
    shift: Float[np.ndarray, " ray"]

    def __getitem__(self, rays: Int[np.ndarray, " few"]) -> "NullDistribution":
        """Take some of the rays."""
        return NullDistribution(self.variance[rays], self.shift[rays])


class Direction(NamedTuple):
    """Direction in which a further function changes the weighted counts of rays.

    Parameters
    ----------
    direction : t / |t|
    root : root of the weights, W^1/2 [1/counts]
    expected : expected counts Y
    """

    direction: Float[np.ndarray, "ray channel"]
    root: Float[np.ndarray, "ray channel"]
    expected: Float[np.ndarray, "ray channel"]


def null_distribution(
    likelihood: EdgeLikelihood,
    functions: Functions,
    further: BasisFunction,
    lengths: Float[np.ndarray, "ray basis"],
    misfit: float | None = None,
) -> NullDistribution:
    """Compute variance and largest shift of u on every ray.

    Parameters
    ----------
    likelihood : likelihood of the rays
    functions : the smaller basis
    further : the function that is judged
    lengths : line integrals of the smaller basis [no unit]
    misfit : conceded relative error of expected counts [no unit], `MISFIT` by default

    Returns
    -------
    variance and shift
    """
    direction, root, expected = _direction(likelihood, functions, further, lengths)
    variance = (direction**2 * root**2 * expected).sum(axis=1)
    conceded = MISFIT if misfit is None else misfit
    return NullDistribution(variance, conceded * (np.abs(direction) * root * expected).sum(axis=1))


def _direction(
    likelihood: EdgeLikelihood, functions: Functions, further: BasisFunction, lengths: Float[np.ndarray, "ray basis"]
) -> Direction:
    """Direction of every ray."""
    known = likelihood.rays.known
    parts = [lengths, np.zeros((len(lengths), 1)), *([] if known is None else [known])]
    expected, slopes = likelihood.transmission((*functions, further)).expected_and_jacobian(np.hstack(parts))
    gains, count = likelihood.rays.gains, len(functions)
    expected, slopes = expected * gains, slopes[..., : count + 1] * gains[..., None]
    spread = expected * (1 + likelihood.dispersion**2 * expected)
    root = np.sqrt(np.divide(1.0, spread, out=np.zeros_like(spread), where=spread > 0))
    slopes = slopes * root[..., None]
    rest = slopes[..., -1] - _within(slopes[..., :-1], slopes[..., -1])
    size = np.sqrt((rest**2).sum(axis=1, keepdims=True))
    return Direction(np.divide(rest, size, out=np.zeros_like(rest), where=size > 0), root, expected)


def excess_score(drops: Float[np.ndarray, " ray"], null: NullDistribution) -> float:
    """Compute by how many standard deviations of noise drops exceed what noise and the conceded misfit give.

    score = (sum max(u - b, 0)^2 - sum q / 2) / sqrt(5/4 sum q^2) with u^2 the drops. For noise alone its mean is 0, or
    less where a misfit is conceded, and its standard deviation at most 1.

    Parameters
    ----------
    drops : drop in deviance of each ray, 0 where the line integral would have to be negative
    null : distribution for rays that do not need the function

    Returns
    -------
    the score [no unit], 0 without rays
    """
    spread = np.sqrt(1.25 * (null.variance**2).sum())
    if not spread > 0:
        return 0.0
    beyond = np.maximum(np.sqrt(np.maximum(drops, 0.0)) - null.shift, 0.0)
    return float(((beyond**2).sum() - null.variance.sum() / 2) / spread)


def _within(
    slopes: Float[np.ndarray, "ray channel basis"], further: Float[np.ndarray, "ray channel"]
) -> Float[np.ndarray, "ray channel"]:
    """Projection of `further` on the other slopes, by least squares."""
    scale = np.sqrt((slopes**2).sum(axis=1, keepdims=True))
    slopes = np.divide(slopes, scale, out=np.zeros_like(slopes), where=scale > 0)
    fisher = np.einsum("rcm,rcn->rmn", slopes, slopes) + 1e-12 * np.eye(slopes.shape[-1])
    right = np.einsum("rcm,rc->rm", slopes, further)
    return np.einsum("rcm,rm->rc", slopes, np.linalg.solve(fisher, right[..., None])[..., 0])
