"""Energy bins cut in two where a function of energy jumps inside one.

A bin whose photons all stand at one node sees a step as a whole or not at all, so that counts do not follow an edge
which moves inside the bin. Cut there, the photons above and below are counted apart, and counts are continuous in the
energy of the edge.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

# A cut closer to a bin's end than this part of its width leaves the bin whole, no unit: the difference is rounding.
_CLOSE = 1e-9


@dataclass(frozen=True, eq=False)
class BinSplit:
    """Energy bins after cuts.

    Parameters
    ----------
    edges, nodes : of the new bins [keV]
    parents : old bin that each new one is a part of
    shares : part of the old bin's photons in each new one
    """

    edges: Float[np.ndarray, " energy_plus_1"]
    nodes: Float[np.ndarray, " energy"]
    parents: Int[np.ndarray, " energy"]
    shares: Float[np.ndarray, " energy"]


def split_bins(
    edges: Float[np.ndarray, " energy_plus_1"], nodes: Float[np.ndarray, " energy"], cuts: Iterable[float]
) -> BinSplit:
    """Split bins so that one ends at every cut; photons and mean energy of each bin do not change.

    Parameters
    ----------
    edges : of the bins [keV]
    nodes : mean energy of the photons in each [keV]
    cuts : energies at which bins are to end [keV]; those outside, or on a bin's end, change nothing

    Returns
    -------
    new bins and their part of the old ones

    Notes
    -----
    Inside a bin the density of photons is taken to be linear, as steep as its mean energy says. Of a bin of width w
    whose mean lies d above the middle, the part t w at the bottom has F(t) = t + 6 (d / w) (t^2 - t) of the photons and
    M(t) = t^2 / 2 + 12 (d / w) (t^3 / 3 - t^2 / 4) of their mean position; |d| is held below w / 6, where the density
    reaches 0 at one end.
    """
    edges, nodes = np.asarray(edges, dtype=np.float64), np.asarray(nodes, dtype=np.float64)
    inside = np.array(sorted({float(cut) for cut in cuts if edges[0] < cut < edges[-1]}))
    places = np.clip(np.searchsorted(edges, inside, side="right") - 1, 0, len(nodes) - 1)
    widths = np.diff(edges)
    near = np.minimum(inside - edges[places], edges[places + 1] - inside) <= _CLOSE * widths[places]
    new = np.unique(np.concatenate([edges, inside[~near]]))
    parents = np.searchsorted(edges, new[:-1], side="right") - 1
    width, start = widths[parents], edges[parents]
    tilt = np.clip((nodes[parents] - start) / width - 0.5, -1 / 6, 1 / 6)
    low, high = (new[:-1] - start) / width, (new[1:] - start) / width
    shares = _photons(high, tilt) - _photons(low, tilt)
    moments = _moments(high, tilt) - _moments(low, tilt)
    means = start + width * np.divide(moments, shares, out=(low + high) / 2, where=shares > 0)
    whole = (low == 0) & (high == 1)
    means = np.where(whole, nodes[parents], np.clip(means, new[:-1], new[1:]))
    return BinSplit(new, means, parents, np.where(whole, 1.0, shares))


def _photons(t: np.ndarray, tilt: np.ndarray) -> np.ndarray:
    """Part of the photons in the lowest part t of a bin."""
    return t + 6 * tilt * (t**2 - t)


def _moments(t: np.ndarray, tilt: np.ndarray) -> np.ndarray:
    """Sum of the positions of the photons there, in bin widths."""
    return t**2 / 2 + 12 * tilt * (t**3 / 3 - t**2 / 4)
