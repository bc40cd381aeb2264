"""Whether neighbouring rays agree on a weak K edge that no single ray shows.

The drop in deviance of single rays sees nothing below their noise. Rays that pass the same material, however, have line
integrals of the same sign and size, and their noise is independent. So the line integrals of the edge's function are
summed with weights that neighbours alone suggest:

    score = sum_r I_r t_r (L_r - b_r / sqrt(I_r)) / sqrt(2 sum_r q_r I_r t_r^2),
    t_r = max(0, mean of L over neighbours, weighted by I)

with L_r the likeliest line integral of the function on a ray, I_r its information, all other line integrals unknown,
q_r / I_r the variance that noise gives it, and b_r what a conceded misfit does to it (`recon.kedge.expected_noise`). Of
noise alone the sum is a quadratic form without diagonal, sum_rs w_rs L_r L_s, and each pair counts twice: hence the 2
(variance 2 tr(W^2), as for any Gaussian quadratic form).
"""

import numpy as np
from jaxtyping import Float
from scipy.ndimage import uniform_filter

from phantomgen.dataset.spectral_model import Spectra
from recon.kedge.alternatives import pairs_without_edge
from recon.kedge.expected_noise import null_law
from recon.kedge.profile_likelihood import EdgeLikelihood, Functions
from spectra.basis.basis import BasisFunction

SHARE = 0.1  # of a channel that may lie on the other side of an edge, which is then told all the same
RANKED = 10_000  # rays that tell which pair of materials explains the counts best
OUTER = 9  # pixels along each side of the square of neighbours
INNER = 3  # of the square in the middle that is no part of them: a detector may correlate the noise of adjacent pixels


def agreement(likelihood: EdgeLikelihood, functions: Functions, further: BasisFunction) -> float:
    """Standard deviations of noise by which rays agree on a function.

    Parameters
    ----------
    likelihood : of rays that are not binned: a binned ray averages intensities, and where thickness varies within it,
        that looks like a weak edge
    functions : the basis so far; instead of photoelectric effect and Compton scattering, the pair of materials that
        explains the counts best is tried, too, so that what these are is not taken for an edge
    further : the function that is judged

    Returns
    -------
    the lower score of the two, 0 where no ray has one
    """
    return min(_score(likelihood, others, further) for others in {functions, _best_pair(likelihood, functions)})


def _best_pair(likelihood: EdgeLikelihood, functions: Functions) -> Functions:
    """The pair without an edge, and what else is in the basis, that explains the counts best; some rays tell."""
    some = likelihood.with_rays(likelihood.rays[:: max(len(likelihood.rays) // RANKED, 1)])
    pairs = pairs_without_edge(functions)
    return min(pairs, key=lambda pair: float(np.nan_to_num(some.deviances(pair)[0], nan=np.inf).sum()))


def between_channels(spectra: Spectra, edge: float) -> bool:
    """Whether channels lie below and above an edge [keV], so that counts show its jump and not only its curve.

    A tenth of a channel may lie beyond: a threshold at 33.2 keV tells the edge of iodine, at 33.17 keV.
    """
    lower, upper = np.array(spectra.lower, float), np.array(spectra.upper, float)
    beyond = SHARE * np.where(np.isfinite(upper), upper - lower, 0.0)
    return bool((upper - beyond).min() <= edge <= (lower + beyond).max())


def _score(likelihood: EdgeLikelihood, functions: Functions, further: BasisFunction) -> float:
    """The same for one choice of the other functions."""
    lengths, information = likelihood.last_length((*functions, further))
    template = np.maximum(_neighbours(likelihood.rays.places, lengths, information), 0.0)
    law = null_law(likelihood, functions, further, likelihood.deviances(functions)[1])
    power = float((law.variance * information * template**2).sum())
    sure = information * lengths - np.sqrt(information) * law.shift
    return float((template * sure).sum() / np.sqrt(2 * power)) if power > 0 else 0.0


def _neighbours(
    places: np.ndarray, lengths: Float[np.ndarray, " ray"], information: Float[np.ndarray, " ray"]
) -> Float[np.ndarray, " ray"]:
    """Mean line integral of the rays around each, weighted by their information; 0 where there are none."""
    at = tuple(places)
    sums = []
    for values in (information * lengths, information):
        image = np.zeros(places.max(axis=1, initial=0) + 1)
        image[at] = values
        outer, inner = (
            uniform_filter(image, side, mode="constant", axes=(1, 2))[at] * side**2 for side in (OUTER, INNER)
        )
        sums.append(outer - inner)
    enough = sums[1] > 1e-6 * sums[1].max(initial=0.0)
    return np.divide(sums[0], sums[1], out=np.zeros_like(lengths), where=enough)
