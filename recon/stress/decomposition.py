"""Rays at the limits: decomposition against other solvers, the true line integrals, and the Cramer-Rao bound."""

from collections.abc import Iterator
from functools import lru_cache
from itertools import pairwise

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize, root_scalar

from phantomgen.stress.case import Point
from recon.ops.decompose import PRIOR, decompose
from spectra.basis.basis import Basis, BasisFunction
from spectra.detector.detector import Detector
from spectra.elements.attenuation import edge_energy, mass_attenuation
from spectra.materials.material import Material
from spectra.quadrature import Integrand, cheapest
from spectra.source.source import Filter, Source
from spectra.transmission import Transmission

_PHOTONS = 1e6  # per pixel and view behind all filters
_VOLTAGE, _LOW = 120.0, 20.0  # kV; keV
_BODY = (0.3, 3.0)  # line integrals of photoelectric effect and Compton scatter, some 15 cm of tissue
_RAYS, _SEED = 40_000, 5
_OF_IODINE, _CONCENTRATIONS = (_LOW, 33.17, 45.0, 60.0), (10.0, 3.0, 1.0, 0.3, 0.1)  # keV; mg/ml
_PATH = 20.0  # through a contrast agent [mm]
_NODES = 1e-4  # tolerance of log counts; the same nodes make and decompose the counts


def few_photons() -> Iterator[Point]:
    """One channel with ever fewer photons: the estimate from every likely count, against the root of the score.

    Yields
    ------
    photons per pixel
    """
    one = _transmission((), (_LOW,), ("compton",))
    depth = np.array([_BODY[1]])
    for photons in (1e5, 1e4, 1e3, 100.0, 10.0, 1.0):
        gain = photons / one.open_beam[0]
        mean = float(gain * one.expected(depth[None])[0, 0])
        counts = np.unique(np.round(np.linspace(max(mean - 4 * mean**0.5, 0), mean + 4 * mean**0.5 + 2, 15)))
        found = decompose(counts[:, None], np.full((len(counts), 1), gain), one)[0][:, 0]
        expected = np.array([_root_of_score(one, gain, count) for count in counts])
        yield _worst(photons, found, expected)


def channels_without_counts() -> Iterator[Point]:
    """Counts of ever more channels lost: the estimate against a general minimiser of the same likelihood.

    Yields
    ------
    channels without counts, of four
    """
    four = _transmission((), (_LOW, 45.0, 60.0, 80.0))
    counts = four.expected(np.array([_BODY]))
    for lost in range(4):
        left = counts.copy()
        left[:, :lost] = 0.0
        found = decompose(left, np.ones_like(left), four, iterations=500, tolerance=1e-8)[0][0]
        yield _worst(lost, found, _minimum(four, left[0], np.array(_BODY)))


def two_near_edges() -> Iterator[Point]:
    """Two contrast agents whose K edges lie ever nearer: line integrals from counts without noise.

    Yields
    ------
    distance of the edges [keV]
    """
    for first, second in (("I", "Gd"), ("Gd", "Yb"), ("Hf", "W"), ("Gd", "Dy"), ("Yb", "Lu")):
        edges = sorted((edge_energy(first), edge_energy(second)))
        thresholds = (_LOW, edges[0], edges[1], edges[1] + 8, edges[1] + 20)
        yield _recovered(edges[1] - edges[0], (first, second), thresholds)


def distant_threshold() -> Iterator[Point]:
    """Iodine, with the nearest threshold ever farther above its K edge: line integrals from counts without noise.

    Yields
    ------
    distance of the threshold above the edge [keV]
    """
    for distance in (0.0, 2.0, 5.0, 10.0, 20.0, 40.0):
        edge = edge_energy("I") + distance
        yield _recovered(distance, ("I",), (_LOW, edge, edge + 10, edge + 20))


def faint_contrast() -> Iterator[Point]:
    """Iodine ever more dilute along 20 mm: mean of the estimates from noisy counts, in standard errors.

    What is expected is the true line integral and the bias that maximum likelihood has at so many counts.

    Yields
    ------
    iodine [mg/ml]
    """
    model = _transmission(("I",), _OF_IODINE)
    for concentration in _CONCENTRATIONS:
        lengths = np.array([*_BODY, _line_integral("I", concentration)])
        found = _estimates(concentration)
        expected = float((lengths + _bias(model, lengths))[-1])
        error = abs(found.mean() - expected) / (found.std() / np.sqrt(_RAYS))
        yield Point(concentration, float(found.mean()), expected, float(error))


def efficiency() -> Iterator[Point]:
    """Iodine ever more dilute: standard deviation of the estimates, against the Cramer-Rao bound.

    Yields
    ------
    iodine [mg/ml]
    """
    model = _transmission(("I",), _OF_IODINE)
    for concentration in _CONCENTRATIONS:
        lengths = np.array([*_BODY, _line_integral("I", concentration)])
        found = float(_estimates(concentration).std())
        expected = float(model.cramer_rao(lengths)[-1, -1] ** 0.5)
        yield Point(concentration, found, expected, abs(found / expected - 1))


def _recovered(difficulty: float, agents: tuple[str, ...], thresholds: tuple[float, ...]) -> Point:
    """Decompose counts without noise; the error is in standard deviations of the Cramer-Rao bound."""
    model = _transmission(agents, thresholds)
    lengths = np.array([*_BODY, *(_line_integral(agent, 5.0) for agent in agents)])
    counts = model.expected(lengths[None])
    found = decompose(counts, np.ones_like(counts), model, iterations=500, tolerance=1e-8)[0][0]
    errors = np.abs(found - lengths) / np.sqrt(np.diagonal(model.cramer_rao(lengths)))
    worst = int(np.argmax(errors))
    return Point(difficulty, float(found[worst]), float(lengths[worst]), float(errors[worst]))


@lru_cache
def _estimates(concentration: float) -> Float[np.ndarray, " ray"]:
    """Line integrals of iodine from many draws of the counts of one ray."""
    model, lengths = _transmission(("I",), _OF_IODINE), np.array([*_BODY, _line_integral("I", concentration)])
    counts = np.random.default_rng(_SEED).poisson(model.expected(lengths), (_RAYS, len(model))).astype(float)
    return decompose(counts, np.ones_like(counts), model)[0][:, -1]


@lru_cache
def _transmission(
    agents: tuple[str, ...], thresholds: tuple[float, ...], body: tuple[str, ...] = ("photoelectric", "compton")
) -> Transmission:
    """Counts of a photon-counting detector behind a tube of 120 kV, by basis functions of the body and of agents."""
    source = Source.tube(_VOLTAGE, _PHOTONS, filters=(Filter(Material("Al", composition="Al"), 3.0),))
    own = (*(BasisFunction(kind) for kind in body), *(BasisFunction("element", element=agent) for agent in agents))
    most = np.array([{"photoelectric": 1.0, "compton": 6.0}.get(kind, 1.0) for kind in (*body, *agents)])
    detector = Detector.photon_counting(thresholds, _VOLTAGE)
    return cheapest(
        Integrand(source, detector, Basis(own), _LOW), most * 0, most, _NODES, rules=("gauss",)
    ).transmission


def _bias(model: Transmission, lengths: Float[np.ndarray, " basis"]) -> Float[np.ndarray, " basis"]:
    """Bias of maximum likelihood to second order, -1/2 F^-1 sum_c grad Y_c / Y_c tr(F^-1 H_c), and of the prior.

    Cox & Snell 1968, doi:10.1111/j.2517-6161.1968.tb00724.x, for Poisson counts with means Y_c(L) of Hessian H_c.
    """
    (expected,), (slopes,) = model.expected_and_jacobian(lengths[None])
    part = model.weights * np.exp(-lengths @ model.columns)
    curved = np.einsum("mk,nk,k->kmn", model.columns, model.columns, part)
    hessians = np.stack([curved[a:b].sum(axis=0) for a, b in pairwise(model.starts)])
    covariance = model.cramer_rao(lengths)
    traces = np.einsum("mn,cnm->c", covariance, hessians)
    return -covariance @ (slopes.T @ (traces / expected) / 2 + PRIOR * lengths)


def _line_integral(agent: str, concentration: float) -> float:
    """Line integral of a dissolved element: mu / rho where its function is 1 x concentration [mg/ml] x path."""
    at = max(70.0, edge_energy(agent) + 0.01)
    return float(mass_attenuation({agent: 1.0}, np.array([at]))[0]) * concentration * 1e-4 * _PATH


def _root_of_score(model: Transmission, gain: float, count: float) -> float:
    """Line integral at which the derivative of likelihood and prior is 0, by bisection."""

    def score(length: float) -> float:
        expected, slope = model.expected_and_jacobian(np.array([[length]]))
        return float((count / expected[0, 0] - gain) * slope[0, 0, 0] - PRIOR * length)

    return root_scalar(score, bracket=(-60.0, 60.0), xtol=1e-10).root


def _minimum(
    model: Transmission, counts: Float[np.ndarray, " channel"], start: Float[np.ndarray, " basis"]
) -> Float[np.ndarray, " basis"]:
    """Line integrals of largest likelihood and prior, by the method of Nelder and Mead from several starts."""

    def objective(lengths: Float[np.ndarray, " basis"]) -> float:
        expected = np.maximum(model.expected(lengths[None])[0], 1e-300)
        return float((expected - counts * np.log(expected)).sum() + PRIOR / 2 * (lengths**2).sum())

    options = {"xatol": 1e-9, "fatol": 1e-12, "maxiter": 20_000, "maxfev": 40_000}
    tried = [
        minimize(objective, start * factor, method="Nelder-Mead", options=options) for factor in (0.3, 1.0, 3.0, 10.0)
    ]
    return min(tried, key=lambda result: result.fun).x


def _worst(difficulty: float, found: Float[np.ndarray, " n"], expected: Float[np.ndarray, " n"]) -> Point:
    """The entry with the largest difference, relative where the expected value is above 1."""
    errors = np.abs(found - expected) / np.maximum(np.abs(expected), 1.0)
    worst = int(np.argmax(errors))
    return Point(difficulty, float(found[worst]), float(expected[worst]), float(errors[worst]))
