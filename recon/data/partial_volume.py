"""Partial volume: pixels and voxels average over what varies inside of them, while a model knows one value of each.

Four things follow from the counts alone, before anything is reconstructed.

A pixel sums intensities, and the mean of exp(-L) exceeds exp(-mean L): where L changes evenly by 2h across a pixel, by
sinh(h) / h. Neighbouring pixels tell by how much it changes in each direction, but not how evenly. Of a slope that goes
on through a, m and b, the variance within m is (m - a)(b - m) / 12; of a sharp edge within m alone, with a and b on
either side of it, it is (m - a)(b - m) wherever that edge lies. Which of both it is, pixels further out tell: behind an
edge they are as their neighbours. Pixels that are summed tell all of it themselves: their geometric mean is the
intensity of the mean L. A fit to intensities that are not corrected finds too little of what attenuates, and in the
wrong basis, as soft energies suffer more.

Voxels do not resolve what neighbouring pixels tell apart, at the rim of metal above all, and counts are the less noisy
the less their ray is attenuated. So the rays beside an edge would outvote those through it, and voxels end up with less
than the mean of what they hold. Rays close to each other are therefore given the same say: that of the most attenuated.

Corrections are not exact: a rim may lie anywhere in a pixel. Soft channels need the larger ones, so that what is wrong
with them looks like another basis. They therefore count as known to `KNOWN_TO` of themselves, relative to that of the
ray's channel that needs least.
"""

import numpy as np
from jaxtyping import Float, Shaped
from scipy.ndimage import gaussian_filter, minimum_filter

DARK = 0.5  # counts; none are taken for half of one
FEWEST = 5.0  # counts per pixel, on average, from which differences between pixels are trusted
STEEPEST = 3.0  # change of the log intensity from the middle of a pixel to its border; what is steeper counts as that
CERTAIN = 2.0  # standard deviations of its noise that a slope must exceed
EDGE = 0.3  # what a sharp edge adds to the 1/12 of a slope; not the whole of it, as things that are round have none
# how fast that fades as the slope goes on; by `benchmarks/reconstruction/partial_volume_excess.py`, as the one above
BLUNT = 40.0
KNOWN_TO = 0.2  # of a correction; its standard deviation
NEAR = 2  # pixels around one in which rays have the same say
_SIGMA = (0, 0.5, 0.5)  # pixels; the least of noisy counts would be below all of them

Image = Float[np.ndarray, "channel row column"]


def excess_of_pixels(counts: Image, air: Image) -> Image:
    """Logarithm of the mean intensity in each pixel over the intensity of its mean line integral.

    Parameters
    ----------
    counts : of one view
    air : without an object; 0 where a pixel is blind, which then tells nothing and is told nothing
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


def doubtful_shares(counts: Image, air: Image, dispersion: float) -> Image:
    """Share of its information that each count keeps if its correction for partial volume is known to `KNOWN_TO`.

    Variances of counts Y grow from Y + (dispersion Y)^2 by (x Y)^2; x is what the doubt exceeds that of the best of
    those channels of the ray that count anything by. Where none does, nothing is known of corrections.

    Parameters
    ----------
    counts, air : as of `excess_of_pixels`
    dispersion : relative model error besides
    """
    doubt = KNOWN_TO * excess_of_pixels(counts, air)
    least = np.where(counts >= FEWEST, doubt, np.inf).min(axis=0)
    variance = 1 / np.maximum(counts, 1) + dispersion**2
    return variance / (variance + np.square(np.maximum(doubt - least, 0)))


def excess_of_blocks(counts: Image, air: Image, factor: int) -> Float[np.ndarray, "channel coarse_row coarse_column"]:
    """The same for `factor` x `factor` pixels that become one, as they are themselves: mean over geometric mean.

    What noise alone does to it is taken off; where there are hardly any counts, nothing is known.
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


def even_shares(counts: Image, air: Image) -> Image:
    """Share of its information that gives each ray the say of the most attenuated of those within `NEAR` pixels.

    Parameters
    ----------
    counts, air : as of `excess_of_pixels`
    """
    seen = air > 0
    passed = np.where(seen, np.maximum(counts, DARK) / np.where(seen, air, 1), 0).astype(np.float32)
    filled = gaussian_filter(seen.astype(np.float32), _SIGMA)
    smooth = np.where(seen, gaussian_filter(passed, _SIGMA) / np.where(seen, filled, 1), np.inf)
    least = minimum_filter(smooth, (1, 2 * NEAR + 1, 2 * NEAR + 1))
    return np.where(seen, np.minimum(least / np.where(seen, passed, 1), 1), 0).astype(np.float32)


def _logs(counts: Image, air: Image) -> Image:
    """Logarithms of relative intensities; of 1 in blind pixels."""
    return np.log(np.where(air > 0, np.maximum(counts, DARK) / np.where(air > 0, air, 1), 1)).astype(np.float32)


def _differences(logs: Image, axis: int) -> list[Image]:
    """Of the two pixels before each, it and the one before, it and the one after, the two after; NaN if not known."""
    width = [(0, 0)] * logs.ndim
    width[axis] = (2, 2)
    steps = np.diff(np.pad(logs, width, constant_values=np.nan), axis=axis)
    return [np.take(steps, np.arange(logs.shape[axis]) + k, axis=axis) for k in range(4)]


def _beside(images: Float[np.ndarray, "..."], axis: int, step: int) -> Float[np.ndarray, "..."]:
    """What the neighbours have; at the border, a pixel is its own."""
    places = np.clip(np.arange(images.shape[axis]) + step, 0, images.shape[axis] - 1)
    return np.take(images, places, axis=axis)


def _blocks(images: Shaped[np.ndarray, "channel row column"], factor: int) -> Shaped[np.ndarray, "channel r y c x"]:
    channels, rows, columns = images.shape
    return images.reshape(channels, rows // factor, factor, columns // factor, factor)
