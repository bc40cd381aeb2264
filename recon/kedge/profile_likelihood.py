"""How well K edges at given energies explain the counts of some rays: profile likelihood, its width, its bound.

Every ray has line integrals of its own, which are fitted anew for every energy that is tried. What an edge saves is the
drop in deviance, summed over the rays,

    saved(E) = sum_r D_r(without the edge) - D_r(with an edge at E)

and nothing where the line integrals of the edge sum up to less than 0. The energy with the highest sum is the likeliest
one. One sigma is where the sum has fallen by 1. Line integrals of single rays may be negative: held at 0, rays with
little of the element would move the energy away, since noise then has a mean that depends on it.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize_scalar, root_scalar

from phantomgen.dataset.spectral_model import Spectra, in_basis
from recon.data.measurements import in_quanta
from recon.data.readout_noise import with_floor
from recon.kedge.rays import Rays
from spectra.basis.basis import Basis, BasisFunction
from spectra.cramer_rao import least_covariance
from spectra.elements.attenuation import atomic_number, symbol
from spectra.transmission import Transmission

STEP = 1.0  # of the scan [keV]
FINE = 1e-3  # to which the best energy is refined [keV]
PEAKS = 3  # local maxima of the scan that are refined
DIFFERENCE = 0.05  # of the derivatives in an edge's energy [keV]

Functions = tuple[BasisFunction, ...]


@dataclass(frozen=True, eq=False)
class EdgeProfile:
    """What a scan over the energies of one K edge found.

    Parameters
    ----------
    energy : where the edge was tried, ascending [keV]
    saved : drop in deviance against a model without this edge, sum over the rays
    best : likeliest energy [keV]
    low, high : where `saved` has fallen by 1 from its peak [keV], or the ends of the scan where it has not; farther
        away where single rays disagree by more than that
    bound : Cramer-Rao bound of the energy's standard deviation, the line integrals of all rays unknown [keV]
    rays : how many there are
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


@dataclass(frozen=True, eq=False)
class EdgeLikelihood:
    """Deviance of rays as a function of the basis.

    Parameters
    ----------
    rays : those that are judged
    spectra : of the scan; its own basis does not matter
    floor : variance that noise without beam adds to each channel, in quanta
    dispersion : relative model error
    """

    rays: Rays
    spectra: Spectra
    floor: Float[np.ndarray, " channel"]
    dispersion: float

    def transmission(self, functions: Functions) -> Transmission:
        """Line integrals of these functions to expected counts."""
        spectra = in_basis(self.spectra, Basis(functions, self.spectra.basis.reference_energy))
        found = in_quanta(spectra.transmission(), spectra.quantum)
        return with_floor(found, self.floor) if self.floor.any() else found

    def with_rays(self, rays: Rays) -> "EdgeLikelihood":
        """The same of other rays."""
        return replace(self, rays=rays)

    def worst(self, functions: Functions, count: int) -> Rays:
        """Rays whose neighbours these functions explain worst."""
        return self.rays.worst(self.transmission(functions), self.dispersion, count)

    def deviances(self, functions: Functions) -> tuple[Float[np.ndarray, " ray"], Float[np.ndarray, "ray basis"]]:
        """Deviance of every ray from its own best line integrals, and those."""
        return self.rays.explained(self.transmission(functions), self.dispersion)

    def saving(
        self, functions: Functions
    ) -> Callable[[BasisFunction], tuple[Float[np.ndarray, " ray"], Float[np.ndarray, " ray"]]]:
        """What a further function saves on each ray, and its line integrals there."""
        before = self.deviances(functions)[0]

        def saved(further: BasisFunction) -> tuple[Float[np.ndarray, " ray"], Float[np.ndarray, " ray"]]:
            after, lengths = self.deviances((*functions, further))
            return before - after, lengths[:, -1]

        return saved

    def last_length(self, functions: Functions) -> tuple[Float[np.ndarray, " ray"], Float[np.ndarray, " ray"]]:
        """Line integral of the last function on every ray, and its information with all others unknown."""
        lengths, fisher = self.rays.decomposed(self.transmission(functions), self.dispersion)
        return lengths[:, -1], 1 / least_covariance(fisher)[:, -1, -1]

    def edge_information(self, functions: Functions) -> Float[np.ndarray, "edge edge"]:
        """Fisher information of the energies of all K edges among the functions [1/keV^2].

        With G = dY/dE_K and J = dY/dL of a ray, the information is sum_r G^T V^-1 G - G^T V^-1 J F^-1 J^T V^-1 G with
        V = Y + (dispersion Y)^2 and F = J^T V^-1 J: line integrals are nuisances (Schur complement).
        """
        lengths = self.deviances(functions)[1]
        lengths = lengths if self.rays.known is None else np.hstack([lengths, self.rays.known])
        expected, jacobian = self.transmission(functions).expected_and_jacobian(lengths)
        gains = self.rays.gains
        expected, jacobian = expected * gains, jacobian[..., : len(functions)] * gains[..., None]
        variance = expected * (1 + self.dispersion**2 * expected)
        precision = np.divide(1.0, variance, out=np.zeros_like(variance), where=variance > 0)
        ray_gradients = [
            self._slope(functions, i, lengths) for i, f in enumerate(functions) if f.edge_energy is not None
        ]
        slopes = np.stack(ray_gradients, axis=-1)
        own = np.einsum("rc,rce,rcf->ref", precision, slopes, slopes)
        cross = np.einsum("rc,rcm,rce->rme", precision, jacobian, slopes)
        fisher = np.einsum("rc,rcm,rcn->rmn", precision, jacobian, jacobian)
        fisher += 1e-9 * np.trace(fisher, axis1=1, axis2=2)[:, None, None] * np.eye(len(functions))
        lost = np.einsum("rme,rmf->ref", cross, np.linalg.solve(fisher, cross))
        return (own - lost).sum(axis=0)

    def _slope(
        self, functions: Functions, index: int, lengths: Float[np.ndarray, "ray basis"]
    ) -> Float[np.ndarray, "ray channel"]:
        """Derivative of expected counts in the energy of one edge, by differences [counts/keV]."""
        sides = _beside(functions[index])
        counts = []
        for side in sides:
            moved = (*functions[:index], replace(side, name="moved"), *functions[index + 1 :])
            counts.append(self.transmission(moved).expected(lengths) * self.rays.gains)
        return (counts[1] - counts[0]) / (float(sides[1].edge_energy or 0.0) - float(sides[0].edge_energy or 0.0))


def moved_edge(like: BasisFunction, energy: float) -> BasisFunction:
    """The same kind of K edge at another energy [keV]."""
    return replace(like, edge_energy=float(energy), element=None, name="")


def _beside(function: BasisFunction) -> tuple[BasisFunction, BasisFunction]:
    """Functions whose edges lie just below and above: of an element those of its neighbours."""
    if function.kind == "element":
        number = atomic_number(str(function.element))
        low, high = (BasisFunction("element", element=symbol(number + shift)) for shift in (-1, 1))
        return low, high
    edge = float(function.edge_energy or 0.0)
    return moved_edge(function, edge - DIFFERENCE), moved_edge(function, edge + DIFFERENCE)


def scanned_energies(spectra: Spectra, starts: Iterable[float] = ()) -> Float[np.ndarray, " energy"]:
    """Energies at which an edge is tried: about every keV that is detected, and those named."""
    seen = np.flatnonzero(spectra.weights.any(axis=0))
    low, high = spectra.edges[seen[0]] + STEP, spectra.edges[seen[-1] + 1] - STEP
    steps = np.linspace(low, high, max(int(np.ceil((high - low) / STEP)), 2) + 1)
    return np.unique(np.concatenate([steps, [e for e in starts if low < e < high]]))


def scan_edge(
    likelihood: EdgeLikelihood, functions: Functions, like: BasisFunction, energies: Float[np.ndarray, " energy"]
) -> EdgeProfile:
    """Try an edge at all of these energies, then refine the best ones.

    Parameters
    ----------
    likelihood : of the rays
    functions : the other functions of the basis
    like : kind and width of the edge
    energies : to try, ascending [keV]

    Notes
    -----
    The sum has plateaus and wrong local maxima, so nothing descends from a start value: the scan covers the detected
    spectrum, and each of its highest peaks is refined between its neighbours.
    """
    each = likelihood.saving(functions)
    taken = [f.edge_energy for f in functions if f.edge_energy is not None]

    def saved(energy: float) -> float:
        if any(abs(energy - other) < DIFFERENCE for other in taken):
            return 0.0  # two edges at one energy are one
        drop, lengths = each(moved_edge(like, energy))
        return float(drop.sum()) if lengths.sum() > 0 else 0.0

    values = np.array([saved(energy) for energy in energies])
    tried = dict(zip(energies.tolist(), values.tolist(), strict=True))
    for i in _peaks(values)[:PEAKS]:
        bracket = (energies[max(i - 1, 0)], energies[min(i + 1, len(energies) - 1)])
        found: Any = minimize_scalar(lambda e: -saved(e), bounds=bracket, method="bounded", options={"xatol": FINE})
        tried[float(found.x)] = -float(found.fun)
    best = max(tried, key=tried.__getitem__)
    low, high = (_fallen(saved, tried, best, side) for side in (-1, 1))
    wider = max(_spread(each, like, best, low, high) / ((high - low) / 2), 1.0) if high > low else 1.0
    tried |= {low: saved(low), high: saved(high)}
    order = np.array(sorted(tried))
    bound = edge_bound(likelihood, (*functions, moved_edge(like, best)))
    low, high = (
        float(np.clip(best + wider * (end - best), energies[0], energies[-1])) if end != best else best
        for end in (low, high)
    )
    return EdgeProfile(order, np.array([tried[e] for e in order]), best, low, high, bound, len(likelihood.rays))


def _spread(
    each: Callable[[BasisFunction], tuple[Float[np.ndarray, " ray"], Float[np.ndarray, " ray"]]],
    like: BasisFunction,
    best: float,
    low: float,
    high: float,
) -> float:
    """Standard deviation of the energy by how much single rays disagree [keV]; infinite where the profile is no peak.

    Rays with less of the element than their noise move the energy at random, each by its own noise, and the width
    of the profile does not see that. With slopes d_r of the rays' deviances and the bend H of their sum, the deviation
    is sqrt(sum d_r^2) / H (Huber 1967; White 1982, doi:10.2307/1912526).
    """
    half = (high - low) / 2
    if half >= best:
        return np.inf
    below, middle, above = (each(moved_edge(like, best + shift))[0] for shift in (-half, 0.0, half))
    bend = float((2 * middle - below - above).sum()) / half**2
    return float(np.sqrt((((above - below) / (2 * half)) ** 2).sum())) / bend if bend > 0 else np.inf


def edge_bound(likelihood: EdgeLikelihood, functions: Functions) -> float:
    """Cramer-Rao bound of the last function's edge [keV]; an element's counts go over into its neighbours'."""
    if not len(likelihood.rays):
        return np.inf
    return float(np.sqrt(least_covariance(likelihood.edge_information(functions))[-1, -1]))


def _peaks(values: Float[np.ndarray, " energy"]) -> list[int]:
    """Local maxima, the highest first; of a plateau its first point."""
    padded = np.concatenate([[-np.inf], values, [-np.inf]])
    places = np.flatnonzero((padded[1:-1] > padded[:-2]) & (padded[1:-1] >= padded[2:]))
    return places[np.argsort(-values[places], kind="stable")].tolist()


def _fallen(saved: Callable[[float], float], tried: dict[float, float], best: float, side: int) -> float:
    """Where the sum has fallen by 1 below or above the best energy; the end of the scan where it never does."""
    level = tried[best] - 1
    inner = best
    for energy in sorted((e for e in tried if side * (e - best) > 0), key=lambda e: side * e):
        if tried[energy] < level:
            return float(root_scalar(lambda e: saved(e) - level, bracket=(inner, energy), xtol=FINE).root)
        inner = energy
    return inner
