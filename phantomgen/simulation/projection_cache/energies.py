"""Energies at which the projections of a view are kept, so that other spectra need no rays.

A pixel averages intensities over many rays, so that path lengths per ray are not enough, and those per pixel do not
exist. What is kept is p(E) = -log(mean over the pixel of exp(-sum_m mu_m(E) L_m)) at few energies: between absorption
edges a smooth function of log E, which Chebyshev points give at any energy.
"""

from itertools import pairwise
from math import sqrt

import numpy as np
from jaxtyping import Float

from phantomgen.scene.scan import Scan
from phantomgen.simulation.forward_model.sampled_rays import sampled_lengths
from spectra.energy.chebyshev import PiecewiseChebyshev

# Energies that are kept at least [keV]. Below lie L edges of contrast agents: from 10 keV on, contrast-vials takes 188
# nodes and more.
LOWEST, HIGHEST = 20.0, 160.0
# Part of the tolerance that the interpolation may take.
SHARE = 0.1
# Most Chebyshev nodes of an interval, and the ratio of its ends, no unit, below which it is not split again.
_MOST_NODES, _NARROWEST = 12, 1.02
# Rays, and energies between nodes, that interpolation is judged by.
_RAYS, _ENERGIES = 400, 60
# Of projections above, whose photons are 1e-12 or less, the same relative error is wanted as there.
_MOST = -np.log(1e-12)

Values = Float[np.ndarray, "ray energy"]


def cache_energies(scan: Scan, tolerance: float) -> tuple[PiecewiseChebyshev, float]:
    """Find the fewest energies whose projections give those at all other energies.

    Parameters
    ----------
    scan : what is simulated; its channels and source widen the range of energies
    tolerance : worst error of projections that is wanted

    Returns
    -------
    interpolation with these energies, and its worst error on other rays
    """
    low, high = min(LOWEST, scan.detector.lowest), max(HIGHEST, scan.source.maximum)
    lengths, rng = sampled_lengths(scan), np.random.default_rng(0)
    fitted, fresh = (SharedPixels.of(scan, lengths, rng) for _ in range(2))
    pieces = [piece for a, b in pairwise(_cuts(scan, low, high)) for piece in _split(fitted, a, b, tolerance)]
    bounds = (*(a for a, _, _ in pieces), high)
    found = PiecewiseChebyshev(bounds, tuple(count for _, _, count in pieces))
    return found, max(fresh.error(a, b, count) for a, b, count in pieces)


class SharedPixels:
    """Pixels that two rays share, for tests of the interpolation.

    Parameters
    ----------
    scan : whose materials they meet
    first, second : path lengths in the two parts of each pixel [mm]
    part : of the pixel that is the first
    """

    def __init__(self, scan: Scan, first: np.ndarray, second: np.ndarray, part: np.ndarray) -> None:
        self.scan, self.first, self.second, self.part = scan, first, second, part[:, None]

    @classmethod
    def of(cls, scan: Scan, lengths: Float[np.ndarray, "ray material"], rng: np.random.Generator) -> "SharedPixels":
        """Create pixels from pairs of rays, the longest among them.

        A third of the pixels contains one ray; one in six is half air.

        Parameters
        ----------
        scan : what is simulated
        lengths : path lengths [mm], (ray, material)
        rng : source of random numbers

        Returns
        -------
        the pixels
        """
        longest = np.argsort(lengths.sum(axis=1))[-_RAYS // 10 :]
        first = lengths[np.append(rng.integers(len(lengths), size=_RAYS), longest)]
        second, part = rng.permutation(first), rng.random(len(first))
        second[::3] = first[::3]
        second[1::6] = 0.0
        return cls(scan, first, second, part)

    def projections(self, energy: Float[np.ndarray, " energy"]) -> Values:
        """Compute the projections of each pixel.

        Parameters
        ----------
        energy : energies [keV]

        Returns
        -------
        projections, (pixel, energy)
        """
        curves = attenuation(self.scan, energy)
        one, two = (lengths @ curves for lengths in (self.first, self.second))
        less = np.minimum(one, two)
        mean = self.part * np.exp(less - one) + (1 - self.part) * np.exp(less - two)
        return less - np.log(mean)

    def error(self, low: float, high: float, count: int) -> float:
        """Compute the worst error of projections between two energies, interpolated from `count` nodes.

        Parameters
        ----------
        low, high : limits [keV]
        count : number of nodes

        Returns
        -------
        worst error
        """
        piece = PiecewiseChebyshev((low, high), (count,))
        energy = low * (high / low) ** ((np.arange(_ENERGIES) + 0.5) / _ENERGIES)
        exact = self.projections(energy)
        found = self.projections(piece.nodes) @ piece.matrix(energy).T
        return float((np.abs(found - exact) / np.maximum(exact / _MOST, 1.0)).max(initial=0.0))


def attenuation(scan: Scan, energy: Float[np.ndarray, " energy"]) -> Float[np.ndarray, "material energy"]:
    """Compute the attenuation of the materials.

    Parameters
    ----------
    scan : what is simulated
    energy : energies [keV]

    Returns
    -------
    attenuation [1/mm], (material, energy)
    """
    return np.stack([m.attenuation(energy, scan.basis) for m in scan.scene.materials])


def _cuts(scan: Scan, low: float, high: float) -> list[float]:
    """Ends of the range, and the edges of materials between."""
    materials = scan.scene.materials
    edges = {edge for m in materials for edge in m.k_edges(low, high)}
    if any(m.composition is None for m in materials):
        edges |= {edge for edge in scan.basis.breaks if low < edge < high}
    return [low, *sorted(edges), high]


def _split(pixels: SharedPixels, low: float, high: float, tolerance: float) -> list[tuple[float, float, int]]:
    """Intervals between two energies and nodes in each: one of them, or as many as the fewest nodes ask for."""
    enough = (n for n in range(1, _MOST_NODES + 1) if pixels.error(low, high, n) <= tolerance)
    count = next(enough, None)
    if high / low < _NARROWEST:
        return [(low, high, count or _MOST_NODES)]
    if count is not None:
        return [(low, high, count)]
    middle = sqrt(low * high)
    return [*_split(pixels, low, middle, tolerance), *_split(pixels, middle, high, tolerance)]
