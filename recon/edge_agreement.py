"""Whether neighbouring rays agree on a weak K edge that no single ray shows.

The drop in deviance of single rays sees nothing below their noise. Rays that pass the same material, however, have line
integrals of the same sign and size, and their noise is independent. So the line integrals of the edge's function are
summed with weights that neighbours alone suggest:

    score = sum_r I_r t_r L_r / sqrt(2 sum_r I_r t_r^2),    t_r = max(0, mean of L over neighbours, weighted by I)

with L_r the likeliest line integral of the function on a ray and 1 / I_r its Cramer-Rao variance, all other line
integrals unknown. Of noise alone the sum is a quadratic form without diagonal, sum_rs w_rs L_r L_s, and each pair
counts twice: hence the 2 (variance 2 tr(W^2), as for any Gaussian quadratic form).
"""

import numpy as np
from jaxtyping import Float
from scipy.ndimage import uniform_filter

from phantomgen.dataset_spectra import Spectra
from recon.edge_elements import plain_alternatives
from recon.edge_profile import EdgeLikelihood, Functions
from spectra.basis import BasisFunction

OUTER = 9  # pixels along each side of the square of neighbours
INNER = 3  # of the square in the middle that is no part of them: a detector may correlate the noise of adjacent pixels


def agreement(likelihood: EdgeLikelihood, functions: Functions, further: BasisFunction) -> float:
    """Standard deviations of noise by which rays agree on a function; the least of all choices of the others.

    Parameters
    ----------
    likelihood : of rays that are not binned: a binned ray averages intensities, and where thickness varies within it,
        that looks like a weak edge
    functions : the basis so far; instead of photoelectric effect and Compton scattering, water and bone are tried, too,
        so that what tissues are is not taken for an edge
    further : the function that is judged

    Returns
    -------
    score, 0 where no ray has one
    """
    return min(_score(likelihood, others, further) for others in plain_alternatives(functions))


def between_channels(spectra: Spectra, edge: float) -> bool:
    """Whether whole channels lie below and above an edge [keV], so that counts show its jump and not only its curve."""
    return bool(min(spectra.upper) <= edge <= max(spectra.lower))


def _score(likelihood: EdgeLikelihood, functions: Functions, further: BasisFunction) -> float:
    """The same for one choice of the other functions."""
    lengths, information = likelihood.last_length((*functions, further))
    template = np.maximum(_neighbours(likelihood.rays.places, lengths, information), 0.0)
    power = float((information * template**2).sum())
    return float((information * template * lengths).sum() / np.sqrt(2 * power)) if power > 0 else 0.0


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
