"""Spatial correlation of neighbouring rays, which shows a weak K edge that no single ray shows.

The drop in deviance of single rays shows nothing below their noise. Rays through the same material, however, have line
integrals of the same sign and size, and their noise is independent. So the line integrals of the function of the edge
are summed with weights from the neighbours alone:

    score = sum_r I_r t_r (L_r - b_r / sqrt(I_r)) / sqrt(2 sum_r q_r I_r t_r^2),
    t_r = max(0, mean of L over neighbours, weighted by I)

with L_r the most likely line integral of the function on a ray, I_r its information, all other line integrals unknown,
q_r / I_r its variance by noise, and b_r its shift by a conceded misfit (`recon.kedge.expected_noise`). For noise alone
the sum is a quadratic form without diagonal, sum_rs w_rs L_r L_s, and each pair occurs twice: hence the 2 (variance
2 tr(W^2), as for any Gaussian quadratic form).
"""

import numpy as np
from jaxtyping import Float
from scipy.ndimage import uniform_filter

from phantomgen.dataset.spectral_model import Spectra
from recon.kedge.alternatives import pairs_without_edge
from recon.kedge.edge_likelihood import EdgeLikelihood, Functions
from recon.kedge.expected_noise import null_distribution
from spectra.basis.basis import BasisFunction

SHARE = 0.1  # of a channel; part that may lie on the other side of an edge which the channel still shows; by hand
RANKED = 10_000  # rays; sample that decides which pair of materials explains the counts best; chosen by hand
OUTER = 9  # pixels along each side of the square of neighbours; chosen by hand, not measured
# pixels along each side of the square in its middle that is left out, as a detector may correlate the noise of adjacent
# pixels; chosen by hand, not measured
INNER = 3


def correlation_score(likelihood: EdgeLikelihood, functions: Functions, further: BasisFunction) -> float:
    """Compute how many standard deviations of noise the correlation of neighbouring rays for a function exceeds 0.

    Parameters
    ----------
    likelihood : likelihood of rays that are not binned: a binned ray averages intensities, and where thickness varies
        within it, that resembles a weak edge
    functions : the basis so far; in place of its first two functions, the pair of materials that explains the counts
        best is tried as well, so that a real material is not taken for an edge
    further : the function that is judged

    Returns
    -------
    the lower score of the two [no unit], 0 without rays
    """
    return min(_score(likelihood, others, further) for others in {functions, _best_pair(likelihood, functions)})


def _best_pair(likelihood: EdgeLikelihood, functions: Functions) -> Functions:
    """The basis whose pair without an edge explains the counts of a sample of the rays best."""
    some = likelihood.with_rays(likelihood.rays[:: max(len(likelihood.rays) // RANKED, 1)])
    pairs = pairs_without_edge(functions)
    return min(pairs, key=lambda pair: float(np.nan_to_num(some.deviances(pair)[0], nan=np.inf).sum()))


def between_channels(spectra: Spectra, edge: float) -> bool:
    """Tell whether channels lie below and above an edge, so that counts show its jump and not only its curve.

    A tenth of a channel may lie beyond: a threshold at 33.2 keV shows the edge of iodine, at 33.17 keV.

    Parameters
    ----------
    spectra : spectral model of the scan
    edge : energy of the edge [keV]

    Returns
    -------
    whether both sides have a channel
    """
    lower, upper = np.array(spectra.lower, float), np.array(spectra.upper, float)
    beyond = SHARE * np.where(np.isfinite(upper), upper - lower, 0.0)
    return bool((upper - beyond).min() <= edge <= (lower + beyond).max())


def _score(likelihood: EdgeLikelihood, functions: Functions, further: BasisFunction) -> float:
    """Score of `correlation_score` for one choice of the other functions."""
    lengths, information = likelihood.last_length((*functions, further))
    template = np.maximum(_neighbours(likelihood.rays.places, lengths, information), 0.0)
    null = null_distribution(likelihood, functions, further, likelihood.deviances(functions)[1])
    power = float((null.variance * information * template**2).sum())
    sure = information * lengths - np.sqrt(information) * null.shift
    return float((template * sure).sum() / np.sqrt(2 * power)) if power > 0 else 0.0


def _neighbours(
    places: np.ndarray, lengths: Float[np.ndarray, " ray"], information: Float[np.ndarray, " ray"]
) -> Float[np.ndarray, " ray"]:
    """Mean line integral of the rays around each, weighted by their information; 0 without neighbours."""
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
