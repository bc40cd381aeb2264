"""Pixels that do not measure, found by their flats, their darks and their changes from view to view.

A pixel that works varies between views at least as photons do, reads more in the open beam than without it, and reads
in the flats about what its neighbours read. Bits are those of ``pixel_mask`` of NXdetector (NeXus definitions).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, UInt32
from scipy import ndimage

from phantomgen.effects.defects import CLUSTER, DEAD, HOT

UNDER, NOISY = 1 << 2, 1 << 4  # bits of NXdetector: under-responding, noisy

# All chosen by hand.
SILENT = 0.05  # of the open beam of the neighbours; a pixel that reads less is dead
STILL = 0.2  # of the variance of photons; a pixel that varies less between views is stuck
UNLIKE = 0.3  # relative difference of the open beam from that of the neighbours; a larger one is no matter of gain
CERTAIN = 6.0  # robust standard deviations of such differences over the panel; a defect must exceed these, too
RESTLESS = 4.0  # times the largest variance between views of the neighbours; a pixel that varies more is noisy
NEAR = 5  # pixels along each side of the neighbourhood
WHOLE_LINE = 0.5  # of a row or column; more bad pixels than that make all of it bad
FEW = 4  # bad pixels that touch each other and are a cluster
FEWEST_VIEWS = 8  # views below which nothing is said of changes between views

Image = Float[np.ndarray, "row column"]


@dataclass(frozen=True, eq=False)
class PixelStatistics:
    """What is known of the pixels of a channel, darks subtracted, in quanta of the detector.

    Parameters
    ----------
    air : mean of the flats
    dark : mean of the darks, not subtracted
    mean : over the views
    variance : between the views
    views : their number
    """

    air: Image
    dark: Image
    mean: Image
    variance: Image
    views: int


def find_bad_pixels(found: PixelStatistics) -> UInt32[np.ndarray, "row column"]:
    """Find the bad pixels of a channel.

    Parameters
    ----------
    found : statistics of the channel

    Returns
    -------
    bits of each pixel; 0 for a pixel that measures
    """
    mask = np.zeros(found.air.shape, np.uint32)
    around = _median_around(found.air)
    level = np.maximum(around, np.median(found.air))
    difference = np.divide(found.air, around, out=np.zeros_like(around), where=around > 0) - 1
    limit = max(UNLIKE, CERTAIN * _spread(difference))
    mask[difference < -limit] = UNDER
    mask[difference > limit] = HOT
    mask[found.air <= SILENT * level] = DEAD
    if found.views >= FEWEST_VIEWS:
        photons = found.mean + np.maximum(found.dark, 0)
        still = found.variance < STILL * photons * _least_scatter(found.views)
        mask[still & (photons > 0)] = HOT
        mask[still & (photons <= SILENT * level)] = DEAD
        mask[(found.variance == 0) & (photons <= 0)] = DEAD
        restless = found.variance > RESTLESS * np.maximum(_largest_around(found.variance, mask > 0), photons)
        mask[restless & (mask == 0)] = NOISY
    return _with_lines_and_clusters(mask)


def _median_around(image: Image) -> Image:
    """Median of the neighbourhood of each pixel, at borders of what is there."""
    return ndimage.median_filter(image, size=NEAR, mode="nearest")


def _largest_around(image: Image, bad: Bool[np.ndarray, "row column"]) -> Image:
    """Largest value of the neighbours of each pixel, itself and bad ones left out."""
    ring = np.ones((NEAR, NEAR), bool)
    ring[NEAR // 2, NEAR // 2] = False
    return ndimage.maximum_filter(np.where(bad, 0.0, image), footprint=ring, mode="constant")


def _spread(values: Image) -> float:
    """Robust standard deviation."""
    return float(1.4826 * np.median(np.abs(values - np.median(values))))


def _least_scatter(views: int) -> float:
    """Part of a variance that an estimate from so many views undercuts by five standard deviations at most."""
    return max(1 - 5 * np.sqrt(2 / max(views - 1, 1)), 0.25)


def _with_lines_and_clusters(mask: UInt32[np.ndarray, "row column"]) -> UInt32[np.ndarray, "row column"]:
    """Mark rows and columns that are bad in most pixels, and bad pixels that touch each other."""
    bad = mask > 0
    rows, columns = bad.mean(axis=1) > WHOLE_LINE, bad.mean(axis=0) > WHOLE_LINE
    if not rows.all() and not columns.all():
        mask[rows[:, None] & ~bad] = DEAD
        mask[columns[None, :] & ~bad] = DEAD
    labels = np.zeros(mask.shape, np.int64)
    count = int(ndimage.label(mask > 0, output=labels))  # type: ignore[arg-type]
    sizes = np.bincount(labels.ravel(), minlength=count + 1)
    sizes[0] = 0
    clustered: Bool[np.ndarray, "row column"] = (sizes >= FEW)[labels]
    mask[clustered] |= CLUSTER
    return mask
