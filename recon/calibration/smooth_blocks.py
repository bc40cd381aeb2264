"""Blocks of pixels behind which attenuation hardly changes: sums of their counts are those of one ray.

Where rays of a block differ, their mean transmission is not that of the mean line integrals, by half the variance of
the log projections. That looks like an error of the spectrum, so such blocks are left out.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from recon.data.measurements import Measurements
from spectra.errors import InputError

# Sides of blocks that are tried [pixel], and the fewest blocks that suffice.
_SIDES, _FEWEST = (4, 2), 300
# Largest variance of the log projections within a block, and least log projection of the softest channel [no unit].
_LARGEST_VARIANCE, _LEAST_PROJECTION = 1e-4, 0.3
MOST_RAYS = 4000


class BlockRays(NamedTuple):
    """Counts of blocks of pixels.

    Parameters
    ----------
    counts : summed over each block
    air : open-beam counts of the same pixels and views
    side : of the blocks [pixel]
    """

    counts: Float[np.ndarray, "ray channel"]
    air: Float[np.ndarray, "ray channel"]
    side: int


def smooth_blocks(measured: Measurements) -> BlockRays:
    """Sum the counts of blocks in which attenuation is even.

    Parameters
    ----------
    measured : counts of some views

    Returns
    -------
    at most `MOST_RAYS` of the blocks, spread over views and panel

    Raises
    ------
    InputError
        When there are too few of them.
    """
    found = 0
    for side in _SIDES:
        counts, air = [], []
        for view in range(len(measured)):
            image = np.asarray(measured.counts[view], dtype=np.float64)
            beam = measured.gains * measured.open_beam * measured.exposure[view, :, None, None]
            sums, open_beam = (_blocks(x, side).sum(axis=-1) for x in (image, beam))
            kept = _is_even(_blocks(image, side), _blocks(beam, side))
            counts.append(sums[:, kept].T)
            air.append(open_beam[:, kept].T)
        found = sum(map(len, counts))
        if found >= _FEWEST:
            chosen = np.unique(np.linspace(0, found - 1, min(found, MOST_RAYS)).astype(int))
            return BlockRays(np.concatenate(counts)[chosen], np.concatenate(air)[chosen], side)
    raise InputError(
        f"the spectrum cannot be refined: attenuation is even in {found} blocks of {_SIDES[-1]} x {_SIDES[-1]} pixels, "
        f"and {_FEWEST} are needed"
    )


def _blocks(images: Float[np.ndarray, "channel row column"], side: int) -> Float[np.ndarray, "channel y x pixel"]:
    """Pixels of each block; rows and columns that fill no block are left out."""
    channels, rows, columns = len(images), images.shape[1] // side, images.shape[2] // side
    cut = images[:, : rows * side, : columns * side].reshape(channels, rows, side, columns, side)
    return cut.swapaxes(2, 3).reshape(channels, rows, columns, side * side)


def _is_even(
    counts: Float[np.ndarray, "channel y x pixel"], air: Float[np.ndarray, "channel y x pixel"]
) -> Bool[np.ndarray, "y x"]:
    """Whether all pixels of a block measure all channels, behind an object whose attenuation is even."""
    together, beam = counts.sum(axis=0), air.sum(axis=0)
    measured = (air > 0).all(axis=(0, -1)) & (together > 0).all(axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        transmission = together / beam
        variance = transmission.var(axis=-1, ddof=1) / transmission.mean(axis=-1) ** 2 - (1 / together).mean(axis=-1)
        projection = np.log(air.sum(axis=-1) / np.maximum(counts.sum(axis=-1), 1)).max(axis=0)
    return measured & (variance < _LARGEST_VARIANCE) & (projection > _LEAST_PROJECTION)
