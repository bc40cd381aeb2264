"""Partial volume: the object varies inside pixels and voxels, while a model has one value of each.

Two corrections of counts and two statistical weights follow from the counts alone, before any reconstruction.

A pixel sums intensities, and the mean of exp(-L) exceeds exp(-mean L): where L changes linearly by 2h across a pixel,
by the factor sinh(h) / h. Neighbouring pixels show by how much L changes in each direction, but not how. For a linear
change through a, m and b, the variance within m is (m - a)(b - m) / 12; for a sharp edge within m alone, with a and b
on either side of it, it is (m - a)(b - m) wherever the edge lies. Pixels further out separate the two cases: beyond an
edge they equal their neighbours. Where pixels are summed they show all of it themselves: their geometric mean is the
intensity of the mean L. A fit to uncorrected intensities finds too little attenuation, and in the wrong basis, as the
effect is larger at low energies.

Voxels cannot resolve what neighbouring pixels resolve, above all at the rim of metal, and counts are less noisy where
their ray is less attenuated. So the rays beside an edge would outweigh those through it, and voxels would end up with
less than their mean. Rays close to each other therefore have equal statistical weight: that of the most attenuated.

The corrections are not exact, as a rim may lie anywhere in a pixel. Low-energy channels need larger corrections, so
that their error resembles another basis. Each correction therefore has a standard deviation of `KNOWN_TO` of itself,
relative to that of the channel of the ray with the smallest correction.
"""

import numpy as np
from jaxtyping import Float, Shaped
from scipy.ndimage import gaussian_filter, minimum_filter

LEAST_COUNTS = 0.5  # counts; fewer are raised to this before a logarithm, as 0 counts have none; a convention
# counts per pixel, on average, from which differences between pixels are used; chosen by hand, not measured
FEWEST = 5.0
# no unit; largest change of the log intensity from the middle of a pixel to its border; chosen by hand, not measured
STEEPEST = 3.0
CERTAIN = 2.0  # standard deviations of its noise that a slope must exceed; chosen by hand, not measured
# no unit; what a sharp edge adds to the 1/12 of a slope; less than 11/12, as round objects have no sharp edge; by
# `python -m benchmarks.reconstruction.partial_volume_excess`
EDGE = 0.3
BLUNT = 40.0  # no unit; how fast that term fades where the slope goes on; by the same measurement
# no unit; standard deviation of a correction over the correction; 0.45 and 0.1 are better and worse for single scenes
# (docs/development/decisions/0005-partial-volume.md)
KNOWN_TO = 0.2
NEAR = 2  # pixels in each direction, within which rays have equal statistical weight; chosen by hand, not measured
# pixels along (channel, row, column); standard deviation of the Gaussian that reduces noise before a minimum is taken
_SIGMA = (0, 0.5, 0.5)

Image = Float[np.ndarray, "channel row column"]


def excess_of_pixels(counts: Image, air: Image) -> Image:
    """Estimate the logarithm of the mean intensity in each pixel over the intensity of its mean line integral.

    Parameters
    ----------
    counts : counts of one view
    air : counts without an object; 0 where a pixel is blind, which is then neither used nor corrected

    Returns
    -------
    excess of the log intensity [no unit], 0 where slopes are not certain
    """
    logs = np.where(air > 0, _logs(counts, air), np.nan)
    variance = 1 / np.maximum(counts, 1)
    out = np.zeros(counts.shape, np.float32)
    for axis in (-2, -1):
        far, before, after, farther = _differences(logs, axis)
        noise = _beside(variance, axis, -1) + _beside(variance, axis, 1)
        known = (np.square(before + after) > CERTAIN**2 * noise) & (before * after > 0)
        goes_on = np.fmin(np.abs(far), np.abs(farther)) / np.maximum(np.maximum(np.abs(before), np.abs(after)), 1e-6)
        sharp = np.nan_to_num(np.maximum(1 - goes_on, 0) / (1 + BLUNT * goes_on))
        within = np.where(known, before * after, 0) * (1 / 12 + EDGE * sharp)
        half = np.clip(np.sqrt(3 * within), 1e-3, STEEPEST)
        out += np.where(known, np.log(np.sinh(half) / half), 0)
    return out


def correction_weights(counts: Image, air: Image, dispersion: float) -> Image:
    """Compute the weights of counts whose correction for partial volume has a standard deviation of `KNOWN_TO`.

    Variances of counts Y grow from Y + (dispersion Y)^2 by (x Y)^2, with x the deviation of the correction beyond that
    of the channel of the ray with the smallest one, among channels with at least `FEWEST` counts. Where no channel has
    so many, weights are 1.

    Parameters
    ----------
    counts, air : as in `excess_of_pixels`
    dispersion : relative model error [no unit]

    Returns
    -------
    part of its information that each count keeps, from 0 to 1
    """
    doubt = KNOWN_TO * excess_of_pixels(counts, air)
    least = np.where(counts >= FEWEST, doubt, np.inf).min(axis=0)
    variance = 1 / np.maximum(counts, 1) + dispersion**2
    return variance / (variance + np.square(np.maximum(doubt - least, 0)))


def excess_of_blocks(counts: Image, air: Image, factor: int) -> Float[np.ndarray, "channel coarse_row coarse_column"]:
    """Compute the excess of `excess_of_pixels` where pixels are summed: logarithm of mean over geometric mean.

    The expected contribution of noise is subtracted.

    Parameters
    ----------
    counts, air : as in `excess_of_pixels`
    factor : pixels along each side of a block that becomes one pixel

    Returns
    -------
    excess of the log intensity of each block [no unit], 0 where there are hardly any counts
    """
    seen = _blocks(air > 0, factor)
    pixels = np.maximum(seen.sum(axis=(-3, -1)), 1)
    relative = _blocks(np.divide(counts, air, out=np.zeros(counts.shape, np.float32), where=air > 0), factor)
    logs = np.where(seen, _blocks(_logs(counts, air), factor), 0).sum(axis=(-3, -1)) / pixels
    mean = relative.sum(axis=(-3, -1)) / pixels
    each = _blocks(counts, factor).sum(axis=(-3, -1)) / pixels
    known = each >= FEWEST
    noise = (1 - 1 / pixels) / (2 * np.where(known, each, 1))
    return np.where(known, np.log(np.where(known, mean, 1)) - logs - noise, 0).astype(np.float32)


def neighbourhood_weights(counts: Image, air: Image) -> Image:
    """Compute the weights that give rays within `NEAR` pixels the information of the most attenuated one.

    Parameters
    ----------
    counts, air : as in `excess_of_pixels`

    Returns
    -------
    part of its information that each count keeps, from 0 to 1; 0 in blind pixels
    """
    seen = air > 0
    passed = np.where(seen, np.maximum(counts, LEAST_COUNTS) / np.where(seen, air, 1), 0).astype(np.float32)
    filled = gaussian_filter(seen.astype(np.float32), _SIGMA)
    smooth = np.where(seen, gaussian_filter(passed, _SIGMA) / np.where(seen, filled, 1), np.inf)
    least = minimum_filter(smooth, (1, 2 * NEAR + 1, 2 * NEAR + 1))
    return np.where(seen, np.minimum(least / np.where(seen, passed, 1), 1), 0).astype(np.float32)


def _logs(counts: Image, air: Image) -> Image:
    """Logarithms of relative intensities; 0 in blind pixels."""
    relative = np.where(air > 0, np.maximum(counts, LEAST_COUNTS) / np.where(air > 0, air, 1), 1)
    return np.log(relative).astype(np.float32)


def _differences(logs: Image, axis: int) -> list[Image]:
    """Four consecutive differences around each pixel, from the two pixels before to the two after; NaN if not known."""
    width = [(0, 0)] * logs.ndim
    width[axis] = (2, 2)
    steps = np.diff(np.pad(logs, width, constant_values=np.nan), axis=axis)
    return [np.take(steps, np.arange(logs.shape[axis]) + k, axis=axis) for k in range(4)]


def _beside(images: Float[np.ndarray, "..."], axis: int, step: int) -> Float[np.ndarray, "..."]:
    """Values of neighbours; at the border, a pixel is its own neighbour."""
    places = np.clip(np.arange(images.shape[axis]) + step, 0, images.shape[axis] - 1)
    return np.take(images, places, axis=axis)


def _blocks(images: Shaped[np.ndarray, "channel row column"], factor: int) -> Shaped[np.ndarray, "channel r y c x"]:
    channels, rows, columns = images.shape
    return images.reshape(channels, rows // factor, factor, columns // factor, factor)
