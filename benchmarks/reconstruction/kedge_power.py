"""How often a K edge is found, and how often one that is not there, against concentration and photons.

    python -m benchmarks.reconstruction.kedge_power

Rays pass 20 to 40 mm of PMMA, a quarter of 400 rays 4 to 8 mm of a solution in water, and are measured in the five
channels of a CdTe sensor with thresholds just above the edges of I, Gd and Au. Attenuation curves are exact, counts are
Poisson numbers, the basis is photoelectric, Compton and one element, and rays are judged as `recon fit` does with
`--bases auto`. Theory: the score is a sum of max(u - b, 0)^2 over rays, with u normal, its mean the K edge's line
integral by its standard deviation (Cramer-Rao, all other line integrals unknown); mean and spread of the sum give the
chance that it exceeds the score that is asked for. The likelihood ratio is that of a test that knows the concentration
to be the same on all rays: Phi(sqrt(sum u^2 / q) - 5).

False edges: rays without any of the three elements, through materials whose curves are no combination of
photoelectric effect and Compton scattering; every vial of every trial is judged for all three.
"""

import argparse
import platform
import time
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from scipy.stats import norm

from phantomgen.dataset.spectral_model import Spectra
from recon.gaussians.recipe import Recipe
from recon.kedge.edge_likelihood import EdgeLikelihood
from recon.kedge.expected_noise import null_distribution
from recon.kedge.judgement import LEAST_SCORE, judge
from recon.kedge.rays import Rays
from spectra.basis.basis import Basis, BasisFunction
from spectra.detector.detector import Detector
from spectra.materials.material import Material
from spectra.source.source import Filter, Source
from spectra.transmission import Transmission

RESULTS = Path(__file__).parents[1] / "results" / "kedge_power.txt"
PLAIN = (BasisFunction("photoelectric"), BasisFunction("compton"))
THRESHOLDS = (20, 33.2, 50.3, 65, 80.8)
ELEMENTS = {"I": (0.25, 0.5, 1, 2, 4), "Gd": (0.25, 0.5, 1, 2, 4), "Au": (0.5, 1, 2, 4, 8)}  # [mg/ml]
SIDE = 20  # rays along each side of a view
ETA = Recipe().dispersion

Curve = Float[np.ndarray, " energy"]


def spectra(photons: float) -> Spectra:
    """A tube at 120 kV behind aluminium, and a CdTe sensor."""
    source = Source.tube(120.0, photons, filters=(Filter(Material("Al", composition="Al"), 2.5),))
    detector = Detector.photon_counting(THRESHOLDS, 120.0)
    energies, spectrum = source.sampled(source.grid(THRESHOLDS[0], 200, detector.breaks))
    limits = np.array([*THRESHOLDS, 120.0])
    basis = Basis(PLAIN)
    return Spectra(
        energies.nodes, energies.edges, spectrum, detector.response(energies), basis, basis.evaluate(energies.nodes),
        detector.names, limits[:-1], limits[1:],
    )  # fmt: skip


def curve(energy: Curve, composition: str, density: float) -> Curve:
    """Attenuation [1/mm]."""
    return Material("m", composition=composition, density=density).attenuation(energy)


def measured(
    source: Spectra, layers: list[tuple[Curve, Float[np.ndarray, " ray"]]], rng: np.random.Generator
) -> EdgeLikelihood:
    """Counts behind layers, each a curve [1/mm] and its lengths [mm], as one square view."""
    transmission = Transmission.from_spectrum(source.weights, np.stack([mu for mu, _ in layers]))
    counts = rng.poisson(transmission.expected(np.stack([mm for _, mm in layers], axis=1))).astype(float)
    places = np.stack(np.meshgrid([0], range(SIDE), range(SIDE), indexing="ij")).reshape(3, -1)
    return EdgeLikelihood(Rays(counts, np.ones_like(counts), None, places), source, np.zeros(counts.shape[1]), ETA)


def thickness(rng: np.random.Generator, low: float, high: float) -> Float[np.ndarray, " ray"]:
    """A smooth thickness over the view [mm]."""
    across = np.linspace(0, 1, SIDE)
    a, b = rng.uniform(0, 1, 2)
    surface = a * across[:, None] + (1 - a) * (4 * across * (1 - across)) * b + (1 - a) * (1 - b) * across
    return low + (high - low) * surface.ravel()


def in_vial() -> Bool[np.ndarray, " ray"]:
    """The rays in the middle quarter of the view."""
    middle = abs(np.arange(SIDE) - (SIDE - 1) / 2) < SIDE / 4
    return np.logical_and.outer(middle, middle).ravel()


def vial(source: Spectra, symbol: str, concentration: float, rng: np.random.Generator) -> EdgeLikelihood:
    """PMMA around a solution, which the middle quarter of the rays pass."""
    energy = source.energy
    solution = curve(energy, "Water, Liquid", 1.0) + curve(energy, symbol, concentration / 1000)
    mm = np.where(in_vial(), thickness(rng, 4, 8), 0.0)
    return measured(source, [(curve(energy, "PMMA", 1.18), thickness(rng, 20, 40)), (solution, mm)], rng)


def theory(model: EdgeLikelihood, symbol: str, concentration: float) -> tuple[float, float]:
    """Chance to find it on the rays of the vial by the law of the score, and by a likelihood ratio that knows more."""
    further = BasisFunction("element", element=symbol)
    information = model.last_length((*PLAIN, further))[1]
    law = null_distribution(model, PLAIN, further, model.deviances(PLAIN)[1])
    reference = max(70.0, float(further.edge_energy or 0) + 0.01)
    per_mg = curve(np.array([reference]), symbol, 1e-3)[0]
    inside = in_vial()
    mean = np.sqrt(information[inside]) * per_mg * concentration * 6.0
    q, b = law.variance[inside], law.shift[inside]
    first, second = _moments(mean - b, np.sqrt(q))
    spread = np.sqrt(1.25 * (q**2).sum())
    score, wide = (first.sum() - q.sum() / 2) / spread, np.sqrt((second - first**2).sum()) / spread
    best = np.sqrt((mean**2 / q).sum())
    return float(norm.cdf((score - LEAST_SCORE) / wide)), float(norm.cdf(best - LEAST_SCORE))


def _moments(mean: np.ndarray, deviation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Means of max(x, 0)^2 and of its square, x normal."""
    z = mean / deviation
    phi, tail = norm.pdf(z), norm.cdf(z)
    second = deviation**2 * ((z**2 + 1) * tail + z * phi)
    fourth = deviation**4 * ((z**4 + 6 * z**2 + 3) * tail + (z**3 + 5 * z) * phi)
    return second, fourth


def power(trials: int, levels: tuple[float, ...]) -> list[str]:
    """Chance to find each element."""
    lines = [f"{'':10}{'mg/ml':>8}" + "".join(f"{f'{n:g} photons':>26}" for n in levels)]
    for symbol, concentrations in ELEMENTS.items():
        further = BasisFunction("element", element=symbol)
        for concentration in concentrations:
            cells = []
            for photons in levels:
                source, rng = spectra(photons), np.random.default_rng(1)
                models = [vial(source, symbol, concentration, rng) for _ in range(trials)]
                found = np.mean([judge(model, PLAIN, further).warranted for model in models])
                score, ratio = theory(models[0], symbol, concentration)
                cells.append(f"{found:>10.2f} ({score:.2f}, {ratio:.2f})")
            lines.append(f"{symbol:10}{concentration:>8g}" + "".join(f"{cell:>26}" for cell in cells))
            print(lines[-1], flush=True)
    return lines


def nulls(energy: Curve, rng: np.random.Generator) -> dict[str, list[tuple[Curve, np.ndarray]]]:
    """Layers without a K edge in the spectrum."""
    pmma = (curve(energy, "PMMA", 1.18), thickness(rng, 10, 35))
    water = (curve(energy, "Water, Liquid", 1.0), thickness(rng, 10, 60))
    return {
        "water": [water],
        "PMMA": [pmma],
        "water, bone": [water, (curve(energy, "cortical bone", 1.92), thickness(rng, 0, 12))],
        "water, calcium": [water, (curve(energy, "Ca", 0.2), thickness(rng, 0, 8))],
        "PMMA, aluminium": [pmma, (curve(energy, "Al", 2.7), thickness(rng, 0, 8))],
        "PMMA, water, steel": [pmma, water, (curve(energy, "Fe", 7.87), thickness(rng, 0, 1))],
        "PMMA, aluminium, steel": [
            pmma, (curve(energy, "Al", 2.7), thickness(rng, 0, 8)), (curve(energy, "Fe", 7.87), thickness(rng, 0, 1)),
        ],
        "polyethylene, titanium": [
            (curve(energy, "Polyethylene", 0.94), thickness(rng, 10, 40)),
            (curve(energy, "Ti", 4.5), thickness(rng, 0, 2)),
        ],
    }  # fmt: skip


def false_edges(trials: int, levels: tuple[float, ...]) -> list[str]:
    """How often an edge that is not there is taken."""
    lines = [f"{'false edges of I, Gd or Au':30}{'trials':>8}{'found':>8}{'highest score':>16}"]
    total = wrong = 0
    names = list(nulls(spectra(1e4).energy, np.random.default_rng(0)))
    for name in names:
        scores = []
        rng = np.random.default_rng(2)
        for photons in levels:
            source = spectra(photons)
            for _ in range(trials):
                model = measured(source, nulls(source.energy, rng)[name], rng)
                scores.append(max(judge(model, PLAIN, BasisFunction("element", element=e)).score for e in ELEMENTS))
        found = sum(score >= LEAST_SCORE for score in scores)
        total, wrong = total + len(scores), wrong + found
        lines.append(f"{name:30}{len(scores):>8}{found:>8}{max(scores):>16.1f}")
        print(lines[-1], flush=True)
    lines.append(f"{'all':30}{total:>8}{wrong:>8}")
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=20, help="of each element, concentration and number of photons")
    parser.add_argument("--null-trials", type=int, default=12, help="of each material and number of photons")
    parser.add_argument("--no-write", action="store_true", help="leave the results file as it is")
    parser.add_argument("--photons", default="1e4,5e4,2e5,1e6", help="per pixel and view, with commas between")
    options = parser.parse_args()
    levels = tuple(map(float, options.photons.split(",")))
    began = time.perf_counter()
    text = [*power(options.trials, levels), "", *false_edges(options.null_trials, levels)]
    head = (
        f"benchmarks/reconstruction/kedge_power.py --trials {options.trials} --null-trials {options.null_trials} "
        f"--photons {options.photons}: "
        f"{time.perf_counter() - began:.0f} s, Python {platform.python_version()}\n"
        "chance to find an element (by the law of the score, by the likelihood ratio)\n"
    )
    if not options.no_write:
        RESULTS.write_text("\n".join([head, *text]) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
