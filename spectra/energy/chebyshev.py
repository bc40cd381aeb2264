"""Interpolation in energy, between edges, from few nodes: linear in the values at the nodes."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from spectra.errors import InputError

# Nearer to a node than this, in log energy, is on it.
_ON_NODE = 1e-13


@dataclass(frozen=True)
class PiecewiseChebyshev:
    """Piecewise interpolation by a polynomial in log energy on each interval.

    Its nodes are Chebyshev points of the first kind. No node lies on a bound, so that a bound may be an absorption
    edge.

    Parameters
    ----------
    bounds : of the intervals, ascending [keV]
    counts : nodes of each interval

    References
    ----------
    Berrut & Trefethen 2004, SIAM Review 46, 501-517, eqs. 4.2 and 5.3, doi:10.1137/S0036144502417715
    """

    bounds: tuple[float, ...]
    counts: tuple[int, ...]

    def __post_init__(self) -> None:
        ascending = all(0 < a < b for a, b in pairwise(self.bounds))
        if len(self.bounds) < 2 or not ascending or len(self.counts) != len(self.bounds) - 1 or min(self.counts) < 1:
            raise InputError(f"intervals {self.bounds} and nodes in each, {self.counts}, do not make an interpolation")

    @property
    def nodes(self) -> Float[np.ndarray, " node"]:
        """Energies of all nodes, ascending [keV]."""
        return np.concatenate([_points(a, b, n) for (a, b), n in zip(pairwise(self.bounds), self.counts, strict=True)])

    def matrix(self, energy: Float[np.ndarray, " energy"]) -> Float[np.ndarray, "energy node"]:
        """Compute the matrix from values at the nodes to values at `energy`; each row sums to 1.

        Parameters
        ----------
        energy : energies [keV]

        Returns
        -------
        matrix, (energy, node)

        Raises
        ------
        InputError
            Outside of the intervals.
        """
        energy = np.asarray(energy, dtype=np.float64)
        low, high = self.bounds[0], self.bounds[-1]
        if len(energy) and not (low <= energy.min() and energy.max() <= high):
            raise InputError(f"{energy.min():g} .. {energy.max():g} keV is not within {low:g} .. {high:g} keV")
        own = np.searchsorted(self.bounds[1:-1], energy, side="right")
        found, first = np.zeros((len(energy), sum(self.counts))), 0
        for i, ((a, b), count) in enumerate(zip(pairwise(self.bounds), self.counts, strict=True)):
            rows = own == i
            found[rows, first : first + count] = _barycentric(energy[rows], _points(a, b, count))
            first += count
        return found


def _points(low: float, high: float, count: int) -> Float[np.ndarray, " node"]:
    """Chebyshev points of the first kind in log energy, ascending [keV]."""
    x = -np.cos(np.pi * (np.arange(count) + 0.5) / count)
    return np.sqrt(low * high) * (high / low) ** (x / 2)


def _barycentric(
    energy: Float[np.ndarray, " energy"], nodes: Float[np.ndarray, " node"]
) -> Float[np.ndarray, "energy node"]:
    """Weights of the nodes of one interval."""
    i = np.arange(len(nodes))
    weights = (-1.0) ** i * np.sin(np.pi * (i + 0.5) / len(nodes))
    apart = np.log(energy)[:, None] - np.log(nodes)
    shares = weights / np.where(np.abs(apart) < _ON_NODE, _ON_NODE, apart)
    return shares / shares.sum(axis=1, keepdims=True)
