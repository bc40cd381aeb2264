"""Edges in a spectrum at the limits: log projections against closed forms.

The source has the same number of photons per keV everywhere, the sensor absorbs all of them, and basis functions are
sharp steps, so that counts are sums of a few exponentials.
"""

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from phantomgen.stress.case import Point
from spectra.basis.basis import Basis, BasisFunction
from spectra.detector.detector import Detector
from spectra.quadrature import Integrand, cheapest
from spectra.source.source import Source

_EDGE = 50.2391  # K edge of gadolinium [keV] (Bearden & Burr 1967, doi:10.1103/RevModPhys.39.125)
_LOW, _TOP = 20.0, 100.0  # of the spectrum [keV]
_LENGTHS = (3.0, 2.0)  # line integrals of the steps
_TOLERANCE = 1e-6  # of log counts, asked of the energy nodes
_THICK = 1e6  # mm; a sensor that lets nothing through


def threshold_at_an_edge() -> Iterator[Point]:
    """A threshold of the detector ever nearer to a K edge, and on it.

    Yields
    ------
    distance of the threshold above the edge [keV]
    """
    for distance in (10.0, 1.0, 0.1, 1e-3, 1e-6, 0.0):
        yield _compared(distance, (_EDGE,), _EDGE + distance, _TOP)


def voltage_at_an_edge() -> Iterator[Point]:
    """A tube voltage ever nearer to a K edge, and on it.

    Yields
    ------
    tube voltage above the edge [kV]
    """
    for distance in (10.0, 1.0, 0.1, 1e-3, 1e-6, 0.0):
        yield _compared(distance, (_EDGE,), 40.0, _EDGE + distance)


def two_edges() -> Iterator[Point]:
    """Two K edges ever nearer to each other.

    Yields
    ------
    distance of the edges [keV]
    """
    for distance in (10.0, 2.0, 0.5, 0.01, 1e-4, 1e-6):
        yield _compared(distance, (_EDGE, _EDGE + distance), 40.0, _TOP)


def _compared(difficulty: float, edges: Sequence[float], threshold: float, top: float) -> Point:
    """Compare log projections of two channels, below and above the threshold; the worse one counts."""
    steps = tuple(BasisFunction("sigmoid", edge_energy=edge, name=f"step_{i}") for i, edge in enumerate(edges))
    detector = Detector.photon_counting((_LOW, threshold), top, "CdTe", _THICK)
    integrand = Integrand(_flat(top), detector, Basis(steps), _LOW)
    lengths = np.array(_LENGTHS[: len(edges)])
    found = cheapest(integrand, lengths * 0, lengths, _TOLERANCE).transmission.log_projection(lengths[None])[0]
    expected = np.array([_log_projection(edges, *window) for window in pairwise((_LOW, threshold, top))])
    worst = int(np.argmax(np.abs(found - expected)))
    return Point(difficulty, float(found[worst]), float(expected[worst]), float(np.abs(found - expected)[worst]))


def _flat(top: float) -> Source:
    """Photons without a preferred energy."""
    return Source.of_corners(np.array([_LOW, top]), np.array([1e4, 1e4]), {})


def _log_projection(edges: Sequence[float], low: float, high: float) -> float:
    """Log projection of a window of energies: parts between the edges, each with its own transmission."""
    cuts = [low, *(min(max(edge, low), high) for edge in edges), high]
    depths = np.cumsum([0.0, *_LENGTHS[: len(edges)]])
    left = sum((b - a) * np.exp(-depth) for (a, b), depth in zip(pairwise(cuts), depths, strict=True))
    return float(-np.log(left / (high - low)))
