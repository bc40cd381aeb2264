"""Profile likelihood of the energy of one K edge: its peak, its width, its Cramer-Rao bound.

What an edge saves is the drop in deviance, summed over the rays,

    saved(E) = sum_r D_r(without the edge) - D_r(with an edge at E)

and 0 where the line integrals of the edge sum up to less than 0. The energy with the highest sum is the most likely
one. One standard deviation is where the sum has fallen by 1.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize_scalar, root_scalar

from phantomgen.dataset.spectral_model import Spectra
from recon.kedge.edge_likelihood import DIFFERENCE, EdgeLikelihood, Functions, PerRay, moved_edge
from spectra.basis.basis import BasisFunction

STEP = 1.0  # keV; step of the scan over energies; chosen by hand, not measured
FINE = 1e-3  # keV; accuracy of the refined energy; chosen by hand, well below the Cramer-Rao bounds of presets
PEAKS = 3  # number of local maxima of the scan that are refined; chosen by hand, not measured


@dataclass(frozen=True, eq=False)
class EdgeProfile:
    """Profile likelihood of the energy of one K edge.

    Parameters
    ----------
    energy : energies at which the edge was tried, ascending [keV]
    saved : drop in deviance against the basis without this edge, sum over the rays [no unit]
    best : most likely energy [keV]
    low, high : energies where `saved` has fallen by 1 from its peak [keV], or the ends of the scan where it has not;
        farther away where single rays disagree by more than that
    bound : Cramer-Rao bound of the standard deviation of the energy, the line integrals of all rays unknown [keV]
    rays : number of rays
    """

    energy: Float[np.ndarray, " energy"]
    saved: Float[np.ndarray, " energy"]
    best: float
    low: float
    high: float
    bound: float
    rays: int

    @property
    def sigma(self) -> float:
        """Half the width of the profile [keV]."""
        return (self.high - self.low) / 2

    @property
    def peak(self) -> float:
        """Largest drop in deviance."""
        return float(self.saved.max())


def scanned_energies(spectra: Spectra, starts: Iterable[float] = ()) -> Float[np.ndarray, " energy"]:
    """List the energies at which an edge is tried: about every keV of the detected spectrum, and those asked for.

    Parameters
    ----------
    spectra : spectral model of the scan
    starts : energies to try besides [keV]

    Returns
    -------
    energies, ascending [keV]
    """
    low, high = detected_range(spectra)
    steps = np.linspace(low, high, max(int(np.ceil((high - low) / STEP)), 2) + 1)
    return np.unique(np.concatenate([steps, [e for e in starts if low < e < high]]))


def detected_range(spectra: Spectra) -> tuple[float, float]:
    """Find the energies between which an edge may be seen.

    Parameters
    ----------
    spectra : spectral model of the scan

    Returns
    -------
    lowest and highest detected energy, each further inside by the step of the scan [keV]
    """
    seen = np.flatnonzero(spectra.weights.any(axis=0))
    return float(spectra.edges[seen[0]] + STEP), float(spectra.edges[seen[-1] + 1] - STEP)


def scan_edge(
    likelihood: EdgeLikelihood, functions: Functions, edge_shape: BasisFunction, energies: Float[np.ndarray, " energy"]
) -> EdgeProfile:
    """Try an edge at all of these energies, then refine the best ones.

    Parameters
    ----------
    likelihood : likelihood of the rays
    functions : the other functions of the basis
    edge_shape : kind and width of the edge
    energies : energies to try, ascending [keV]

    Returns
    -------
    the profile

    Notes
    -----
    The sum has plateaus and wrong local maxima, so that no descent from a start value is used: the scan covers the
    detected spectrum, and each of its highest peaks is refined between its neighbours.
    """
    saved_by = likelihood.saving(functions)
    taken = [f.edge_energy for f in functions if f.edge_energy is not None]

    def saved(energy: float) -> float:
        if any(abs(energy - other) < DIFFERENCE for other in taken):
            return 0.0  # two edges at one energy are one
        drop, lengths = saved_by(moved_edge(edge_shape, energy))
        return float(drop.sum()) if lengths.sum() > 0 else 0.0

    values = np.array([saved(energy) for energy in energies])
    tried = dict(zip(energies.tolist(), values.tolist(), strict=True))
    for i in _peaks(values)[:PEAKS]:
        bracket = (energies[max(i - 1, 0)], energies[min(i + 1, len(energies) - 1)])
        found: Any = minimize_scalar(lambda e: -saved(e), bounds=bracket, method="bounded", options={"xatol": FINE})
        tried[float(found.x)] = -float(found.fun)
    best = max(tried, key=tried.__getitem__)
    low, high = (_fallen(saved, tried, best, side) for side in (-1, 1))
    wider = 1.0
    if high > low:
        wider = max(_spread(saved_by, edge_shape, best, (high - low) / 2) / ((high - low) / 2), 1.0)
    tried |= {low: saved(low), high: saved(high)}
    order = np.array(sorted(tried))
    bound = likelihood.edge_bound((*functions, moved_edge(edge_shape, best)))
    low, high = (
        float(np.clip(best + wider * (end - best), energies[0], energies[-1])) if end != best else best
        for end in (low, high)
    )
    return EdgeProfile(order, np.array([tried[e] for e in order]), best, low, high, bound, len(likelihood.rays))


def _spread(
    saved_by: Callable[[BasisFunction], tuple[PerRay, PerRay]], edge_shape: BasisFunction, best: float, half: float
) -> float:
    """Standard deviation of the energy from the disagreement of rays [keV]; infinite where the profile has no peak.

    Rays with less of the element than their noise move the energy at random, each by its own noise, and the width of
    the profile does not show that. With slopes d_r of the deviances of rays and the curvature H of their sum, `half` a
    width apart, the deviation is sqrt(sum d_r^2) / H (Huber 1967; White 1982, doi:10.2307/1912526).
    """
    if half >= best:
        return np.inf
    below, middle, above = (saved_by(moved_edge(edge_shape, best + shift))[0] for shift in (-half, 0.0, half))
    bend = float((2 * middle - below - above).sum()) / half**2
    return float(np.sqrt((((above - below) / (2 * half)) ** 2).sum())) / bend if bend > 0 else np.inf


def _peaks(values: Float[np.ndarray, " energy"]) -> list[int]:
    """Local maxima, the highest first; of a plateau its first point."""
    padded = np.concatenate([[-np.inf], values, [-np.inf]])
    places = np.flatnonzero((padded[1:-1] > padded[:-2]) & (padded[1:-1] >= padded[2:]))
    return places[np.argsort(-values[places], kind="stable")].tolist()


def _fallen(saved: Callable[[float], float], tried: dict[float, float], best: float, side: int) -> float:
    """Energy below or above the best one where the sum has fallen by 1; the end of the scan where it never has."""
    level = tried[best] - 1
    inner = best
    for energy in sorted((e for e in tried if side * (e - best) > 0), key=lambda e: side * e):
        if tried[energy] < level:
            return float(root_scalar(lambda e: saved(e) - level, bracket=(inner, energy), xtol=FINE).root)
        inner = energy
    return inner
