"""Model observers: how well a signal is detected in images, and in the counts themselves.

An observer reduces an image to a few numbers and decides between two classes, with the signal and without it. Its
detectability index d' is the distance of the class means in standard deviations.

References
----------
.. [1] Barrett & Myers 2004, Foundations of Image Science, chapters 13 and 14: d', Hotelling observer, observer without
   prewhitening, ideal observer
.. [2] Abbey & Barrett 2001, J. Opt. Soc. Am. A 18, 473: sparse difference-of-Gaussians channels
.. [3] Wunderlich, Noo, Gallas & Heilbrun 2015, IEEE Trans. Med. Imaging 34, 453: estimate and confidence interval of d'
   from the non-central F distribution of Hotelling's T^2
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.optimize import root_scalar
from scipy.stats import ncf

from spectra.errors import InputError

CHANNELS = 3
CENTRE, RATIO, BANDWIDTH = 0.015, 2.0, 2.0  # first width [1/voxel], ratio of widths, bandwidth of a channel: [2]
CONFIDENCE = 0.95

Samples = Float[np.ndarray, "sample feature"]
Images = Float[np.ndarray, "sample row column"]
OtherSamples = Float[np.ndarray, "other_sample feature"]
OtherImages = Float[np.ndarray, "other_sample row column"]


@dataclass(frozen=True)
class Detectability:
    """Detectability index d'.

    Parameters
    ----------
    value : estimate [no unit]
    low, high : ends of the confidence interval of `CONFIDENCE`
    """

    value: float
    low: float
    high: float


def hotelling(present: Samples, absent: OtherSamples) -> Detectability:
    """Compute d' of the Hotelling observer, which knows the covariance of its features: d'^2 = s^T K^-1 s.

    Parameters
    ----------
    present, absent : features of independent images with and without the signal, at least as many as make the
        covariance invertible

    Returns
    -------
    estimate without the bias of few samples, 0 where that is negative, and its confidence interval [3]_

    Raises
    ------
    InputError
        When there are too few images, or they have no noise.
    """
    (n, features), m = present.shape, len(absent)
    freedom = n + m - features - 1
    if freedom < 3 or min(n, m) < 2:
        raise InputError(
            f"d' of {features} features needs {features + 4} images or more, got {n} with and {m} without the signal"
        )
    signal = present.mean(axis=0) - absent.mean(axis=0)
    scatter = _scatter(present) + _scatter(absent)
    if not np.linalg.cond(scatter) < 1e12:
        raise InputError("d' needs images with noise, and features that differ from one another")
    square = float(signal @ np.linalg.solve(scatter / (n + m - 2), signal))
    per_signal = n * m / (n + m)  # Hotelling's T^2 over d'^2
    unbiased = (freedom - 2) / (n + m - 2) * square - features / per_signal
    statistic = freedom / ((n + m - 2) * features) * per_signal * square
    tails = (1 + CONFIDENCE) / 2, (1 - CONFIDENCE) / 2
    low, high = (_noncentrality(statistic, features, freedom, tail) for tail in tails)
    return Detectability(np.sqrt(max(unbiased, 0.0)), np.sqrt(low / per_signal), np.sqrt(high / per_signal))


def without_prewhitening(present: Images, absent: OtherImages, centre: tuple[float, float]) -> Detectability:
    """Compute d' of the observer that compares each image with the signal itself and ignores correlations of noise.

    Parameters
    ----------
    present, absent : independent images with and without a signal that is round, as many of both
    centre : row and column of the signal [voxel]

    Returns
    -------
    estimate, and its confidence interval; each image is compared with the mean difference of the others over rings
    around the centre, as one with its own noise would seem more detectable. What noise is left in the differences
    lowers the estimate: by a fifth for d' = 2.5 and 8 images of each class

    Raises
    ------
    InputError
        When there are fewer than 4 images of each class, or they have no noise.
    """
    if len(present) != len(absent) or len(present) < 4:
        raise InputError(f"d' needs 4 images or more of each class, got {len(present)} and {len(absent)}")
    rows, columns = np.ogrid[: present.shape[1], : present.shape[2]]
    ring = np.rint(np.hypot(rows - centre[0], columns - centre[1])).astype(np.int64).ravel()
    voxels = np.bincount(ring)
    over_rings = [
        np.stack([np.bincount(ring, image.ravel()) for image in images]) / np.maximum(voxels, 1)
        for images in (present, absent)
    ]
    differences = over_rings[0] - over_rings[1]
    templates = voxels * (differences.sum(axis=0) - differences) / (len(present) - 1)
    # the mean image has another product with each template; without it, that would pass for noise
    mean = (over_rings[0] + over_rings[1]).mean(axis=0) / 2
    responses = [((images - mean) * templates).sum(axis=1)[:, None] for images in over_rings]
    return hotelling(*responses)


def channels(shape: tuple[int, int], centre: tuple[float, float]) -> Float[np.ndarray, "channel row column"]:
    """Return the templates of sparse difference-of-Gaussians channels [2]_ around a point of an image.

    Parameters
    ----------
    shape : rows and columns of the image
    centre : row and column of the point [voxel]

    Returns
    -------
    templates, whose products with an image are the outputs of the channels
    """
    rows, columns = np.fft.fftfreq(shape[0])[:, None], np.fft.fftfreq(shape[1])[None, :]
    square = rows**2 + columns**2
    shift = np.exp(-2j * np.pi * (rows * centre[0] + columns * centre[1]))
    widths = CENTRE * RATIO ** np.arange(CHANNELS)
    bands = [np.exp(-square / (2 * (BANDWIDTH * width) ** 2)) - np.exp(-square / (2 * width**2)) for width in widths]
    return np.stack([np.fft.ifft2(band * shift).real for band in bands])


def channelised_hotelling(present: Images, absent: OtherImages, centre: tuple[float, float]) -> Detectability:
    """Compute d' of the Hotelling observer that sees an image through a few channels, as human observers do.

    Parameters
    ----------
    present, absent : independent images with and without the signal
    centre : row and column of the signal [voxel]

    Returns
    -------
    estimate, and its confidence interval

    Raises
    ------
    InputError
        When there are too few images, or they have no noise.
    """
    templates = channels((present.shape[1], present.shape[2]), centre)
    features = [np.einsum("nyx,cyx->nc", images, templates) for images in (present, absent)]
    return hotelling(*features)


def ideal_square(
    present: Float[np.ndarray, "..."], absent: Float[np.ndarray, "..."], variance: Float[np.ndarray, "..."]
) -> float:
    """Compute d'^2 of the ideal observer of independent counts, which no observer of images exceeds.

    Parameters
    ----------
    present, absent : expected counts with and without the signal
    variance : of the counts, larger than 0 where they are measured

    Returns
    -------
    sum of squared differences over variances: the difference of both scans in the metric of the Fisher information
    """
    measured = variance > 0
    return float(np.sum((present - absent)[measured] ** 2 / variance[measured]))


def _scatter(samples: Samples) -> Float[np.ndarray, "feature feature"]:
    """Sum of squares and products around the mean."""
    apart = samples - samples.mean(axis=0)
    return apart.T @ apart


def _noncentrality(statistic: float, features: int, freedom: int, probability: float) -> float:
    """Find the noncentrality for which F is at most the statistic with a probability; 0 where none is so small."""

    def excess(noncentrality: float) -> float:
        return float(ncf.cdf(statistic, features, freedom, noncentrality)) - probability

    if excess(1e-12) <= 0:
        return 0.0
    high = max(4 * statistic * features, 10.0)
    while excess(high) > 0:
        high *= 2
    return float(root_scalar(excess, bracket=(1e-12, high), method="brentq").root)
