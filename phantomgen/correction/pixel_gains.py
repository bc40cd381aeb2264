"""Gains of pixels that flats do not show, from the views: what makes rings in volumes.

The sum over a run of views, over that of the open beam, is a smooth image of the object times the gain of each pixel. A
local polynomial takes the smooth part away (Savitzky & Golay 1964, doi:10.1021/ac60214a047); what is left in all runs
alike is the gain. Edges of the object move from run to run: the median over runs leaves them out, and where runs differ
the estimate shrinks towards 1. Ends of the object along the axis, and edges of one that is round about it, stay where
they are: what a pixel has in common with its neighbours along the row or along the column is therefore left to the
object, and columns get a gain of their own only from rows that see air.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage, signal

from phantomgen.dataset.inpainting import inpainted

# All chosen by hand.
WINDOW, ORDER = 5, 2  # pixels and order of the local polynomial along each axis
ROUNDS = 4  # of taking the smooth part away, as some of a gain leaks into it
LINE = 15  # pixels along a row or column, whose median is what an object may have in common
CERTAIN = 2.5  # standard deviations of such a median, by the scatter of single pixels; smaller ones are gains
SURE = 5.0  # the same, of edges so large that gains beside them are not known
LEAST = 1e-3  # standard deviation of gains below which they stay as they are: objects leave as much
EDGE = 5.0  # robust standard deviations; what exceeds them is no gain
AIR = 0.97  # transmission of air
FEWEST_ROWS = 6  # rows in air from which a column gets a gain
FEWEST_RUNS = 4  # runs of views

Image = Float[np.ndarray, "row column"]


@dataclass(frozen=True, eq=False)
class PixelGains:
    """Gains of the pixels of a channel.

    Parameters
    ----------
    gain : relative to the flats; 1 where nothing is known
    spread : standard deviation of the gains that were found, noise taken away; below `LEAST` they are left at 1
    noise : typical standard uncertainty of a gain [no unit]
    """

    gain: Image
    spread: float
    noise: float


def pixel_gains(
    transmissions: Float[np.ndarray, "run row column"], measures: Bool[np.ndarray, "row column"]
) -> PixelGains:
    """Estimate the gains of a channel.

    Parameters
    ----------
    transmissions : counts of a run of views over those of the open beam, at most a run for each view
    measures : pixels that measure

    Returns
    -------
    the gains
    """
    nothing = PixelGains(np.ones(measures.shape), 0.0, np.inf)
    if len(transmissions) < FEWEST_RUNS or min(measures.shape) < 2 or measures.sum() < WINDOW**2:
        return nothing
    usable = measures & (transmissions > 0).all(axis=0)
    logs = np.log(np.where(usable, np.maximum(transmissions, 1e-12), 1.0))
    columns = _column_gains(np.median(logs, axis=0), usable)
    rough = np.stack([_rough(image, usable) for image in logs])
    common, edges = _common_to_lines(np.median(rough, axis=0) - columns, usable)
    pixels = rough - columns - common
    found = np.median(pixels, axis=0)
    variance = np.var(pixels, axis=0, ddof=1) * (np.pi / 2) / len(pixels)  # of a median
    variance = _local_mean(variance, usable)
    known = usable & ~edges & (np.abs(found) < EDGE * max(_spread(found[usable]), 1e-12))
    typical = float(np.median(variance[usable]))
    spread = max(_spread(found[known]) ** 2 - typical, 0.0)
    shrunk = np.where(known, found * spread / np.maximum(spread + variance, 1e-30), 0.0)
    if np.sqrt(spread) < LEAST:
        shrunk = np.zeros_like(shrunk)
    whole = spread + float(np.var(columns[usable]))
    return PixelGains(np.exp(shrunk + columns), float(np.sqrt(whole)), float(np.sqrt(typical)))


def _rough(image: Image, usable: Bool[np.ndarray, "row column"], axes: tuple[int, ...] = (0, 1)) -> Image:
    """Subtract a local polynomial along some axes from an image; 0 where a pixel does not measure."""
    whole = inpainted(image, ~usable)
    gain = np.zeros_like(image)
    for _ in range(ROUNDS):
        smooth = _smooth(whole - gain, axes)
        gain += np.where(usable, whole - gain - smooth, 0.0)
        whole = np.where(usable, whole, smooth)
    return gain


def _smooth(image: Image, axes: tuple[int, ...]) -> Image:
    """Local polynomials along some axes."""
    for axis in axes:
        count = image.shape[axis]
        width = min(WINDOW, count - 1 + count % 2)
        if width > ORDER:
            image = np.asarray(signal.savgol_filter(image, width, ORDER, axis=axis, mode="interp"))
    return image


def _column_gains(image: Image, usable: Bool[np.ndarray, "row column"]) -> Image:
    """Compute what all rows in air have in common in a column; 0 for columns with few rows in air."""
    reach = np.ones((3, 2 * ROUNDS * (WINDOW // 2) + 1))  # pixels that `_rough` takes a value from
    bright = inpainted(image, ~usable) > np.log(AIR)
    in_air = usable & np.asarray(ndimage.binary_erosion(bright, reach, border_value=1), bool)
    mean = _rough(image, usable, (1,))
    rows = in_air.sum(axis=0)
    common = np.array([np.median(mean[air, c]) if air.any() else 0.0 for c, air in enumerate(in_air.T)])
    spread = np.array([_spread(mean[air, c]) if air.sum() > 1 else np.inf for c, air in enumerate(in_air.T)])
    variance = np.pi / 2 * spread**2 / np.maximum(rows, 1)
    known = (rows >= FEWEST_ROWS) & np.isfinite(variance)
    if not known.any():
        return np.zeros(image.shape)
    wanted = max(float(np.var(common[known]) - np.mean(variance[known])), 0.0)
    if np.sqrt(wanted) < LEAST:
        return np.zeros(image.shape)
    shrunk = np.where(known, common * wanted / np.maximum(wanted + np.where(known, variance, 0), 1e-30), 0.0)
    return np.where(usable, shrunk[None, :], 0.0)


def _common_to_lines(
    image: Image, usable: Bool[np.ndarray, "row column"]
) -> tuple[Image, Bool[np.ndarray, "row column"]]:
    """Medians along columns and rows that exceed the scatter of gains, and where edges make them large."""
    common, left = np.zeros_like(image), np.where(usable, image, 0.0)
    edges = np.zeros(image.shape, bool)
    for size in ((LINE, 1), (1, LINE)):
        lines = ndimage.median_filter(left - common, size=size, mode="nearest")
        scatter = np.sqrt(np.pi / 2 / LINE) * _spread((left - common - lines)[usable])
        common = common + np.where(np.abs(lines) > CERTAIN * scatter, lines, 0.0)
        edges |= np.abs(lines) > SURE * scatter
    return common, np.asarray(ndimage.binary_dilation(edges, np.ones((WINDOW, WINDOW))), bool)


def _local_mean(image: Image, usable: Bool[np.ndarray, "row column"]) -> Image:
    """Mean over 3 x 3 pixels that measure."""
    weights = ndimage.uniform_filter(usable.astype(float), 3)
    total = ndimage.uniform_filter(np.where(usable, image, 0.0), 3)
    return np.divide(total, weights, out=np.full(image.shape, np.inf), where=weights > 1e-9)


def _spread(values: np.ndarray) -> float:
    """Robust standard deviation."""
    return float(1.4826 * np.median(np.abs(values - np.median(values)))) if values.size else 0.0
