"""Tube output of each view, from parts of the panel that see nothing but air in all views."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

# All chosen by hand.
TOLERANCE = 0.004  # relative; gains that drift and scatter make blocks in air differ by so much
CERTAIN = 4.0  # standard deviations that a block may differ from the air of its view
FEWEST = 2  # blocks of air
WORST = 0.005  # relative standard uncertainty of a view; a worse one is not worth applying
ROUNDS = 5  # of choosing blocks and computing the output
STEADY = 1.5  # mean square of the changes over their variance; less is noise


@dataclass(frozen=True, eq=False)
class BlockSums:
    """Counts in blocks of pixels, and what they are in the open beam at the stated tube output.

    Parameters
    ----------
    counts : darks subtracted, all channels together, in quanta of the detector
    air : expected without an object
    """

    counts: Float[np.ndarray, "view block"]
    air: Float[np.ndarray, "view block"]


@dataclass(frozen=True, eq=False)
class TubeOutput:
    """Tube output of the views, relative to what is stated.

    Parameters
    ----------
    factors : of each view
    uncertainty : standard uncertainty of each factor, by photons
    blocks : blocks that see air in all views
    """

    factors: Float[np.ndarray, " view"]
    uncertainty: Float[np.ndarray, " view"]
    blocks: Bool[np.ndarray, " block"]

    @property
    def is_known(self) -> bool:
        """Whether enough of the panel sees air."""
        return bool(self.blocks.sum() >= FEWEST and self.uncertainty.max(initial=0) <= WORST)

    @property
    def is_steady(self) -> bool:
        """Whether the factors differ from 1 by no more than noise."""
        return bool(np.mean(((self.factors - 1) / self.uncertainty) ** 2) < STEADY)


def tube_output(sums: BlockSums) -> TubeOutput:
    """Estimate the tube output.

    A block sees air if it reads as much as the air of its view in every view, and on the mean over the views. The first
    guess of air is the block that reads most in its weakest view.

    Parameters
    ----------
    sums : counts in blocks

    Returns
    -------
    the output; not known where too few blocks see air
    """
    usable = np.asarray((sums.air > 0).all(axis=0) & (sums.counts > 0).all(axis=0))
    views = len(sums.counts)
    nothing = TubeOutput(np.ones(views), np.full(views, np.inf), np.zeros(sums.air.shape[1], bool))
    if not usable.any():
        return nothing
    ratio = np.divide(sums.counts, sums.air, out=np.zeros_like(sums.counts), where=sums.air > 0)
    noise = np.divide(np.sqrt(np.maximum(sums.counts, 1)), sums.air, out=np.full_like(ratio, np.inf), where=usable)
    blocks = _first_guess(ratio, noise, usable)
    for _ in range(ROUNDS):
        factors = sums.counts[:, blocks].sum(axis=1) / sums.air[:, blocks].sum(axis=1)
        apart, limit = ratio / factors[:, None] - 1, noise / factors[:, None]
        steady = (np.abs(apart) <= CERTAIN * limit + TOLERANCE).all(axis=0)
        even = np.abs(apart.mean(axis=0)) <= CERTAIN * limit.mean(axis=0) / np.sqrt(views) + TOLERANCE
        found = usable & steady & even
        if not found.any() or (found == blocks).all():
            break
        blocks = found
    if not blocks.any():
        return nothing
    total = sums.counts[:, blocks].sum(axis=1)
    air = sums.air[:, blocks].sum(axis=1)
    return TubeOutput(total / air, np.sqrt(total) / air, blocks)


def _first_guess(
    ratio: Float[np.ndarray, "view block"], noise: Float[np.ndarray, "view block"], usable: Bool[np.ndarray, " block"]
) -> Bool[np.ndarray, " block"]:
    """Blocks that read about as much as the brightest part of their view, in all views."""
    bright = np.quantile(ratio[:, usable], 0.98, axis=1)[:, None]
    weakest = np.min(ratio / bright + CERTAIN * noise / bright, axis=0, where=usable, initial=np.inf)
    weakest[~usable] = -np.inf
    return weakest >= min(1 - TOLERANCE, weakest.max())
