"""Energy nodes against the error of log counts, and how well bases are conditioned.

    python -m benchmarks.simulator.energy_quadrature

Worst error of log counts over the corners of a box and 2000 rays in it, denser towards its faces; in brackets the rms.
The box: water 0..400 mm, iodine 0..100 mg/cm^2, cortical bone 0..50 mm, titanium 0..5 mm, as many as the case has.
The truth is Gauss-Legendre with four nodes in every half keV, at all corners of the spectrum and all edges, about 4800
nodes; twice as many change log counts by 6e-9, and by 5e-7 where 1e-12 of the photons are left. `midpoint` has its
nodes on 20..140 keV whatever the case, so few of them fall into a narrow channel; the other rules get at most the
number of nodes at the head of the column.
"""

import time

import numpy as np

from spectra import quadrature as rules
from spectra.basis.basis import Basis, BasisFunction
from spectra.basis.conditioning import conditioning_of
from spectra.energy.grid import Energies
from spectra.energy.node_reduction import sample_box
from spectra.materials.material import Material
from spectra.quadrature import Integrand
from spectra.source.source import Filter, Source

NODES = (8, 16, 32, 64)
TOLERANCES = (1e-2, 1e-3, 1e-4, 3e-5, 1e-5, 1e-6)
IODINE = Material("iodine", composition="I")
MATERIALS = {
    "water": (Material("water", composition="water"), 400.0),
    "iodine": (IODINE, 1.0 / IODINE.density),
    "bone": (Material("bone", composition="Bone, Cortical (ICRP)"), 50.0),
    "titanium": (Material("titanium", composition="Ti"), 5.0),
}
OBJECTS = {"water": 1, "+ iodine": 2, "+ bone + Ti": 4}


class Window:
    """An ideal counter of all photons between two energies [keV]."""

    def __init__(self, lower: float, upper: float) -> None:
        self.names, self.breaks = (f"{lower:g}..{upper:g}",), (lower, upper)

    def response(self, energies: Energies) -> np.ndarray:
        low, high = energies.edges[:-1], energies.edges[1:]
        inside = np.minimum(high, self.breaks[1]) - np.maximum(low, self.breaks[0])
        return np.clip(inside / (high - low), 0.0, 1.0)[None]


class Integrating:
    """Energy absorbed in 0.6 mm of columnar CsI, E (1 - exp(-mu t))."""

    def __init__(self) -> None:
        self.material = Material("CsI", 3.6, "CsI")
        self.names, self.breaks = ("energy",), self.material.k_edges(10.0, 150.0)

    def response(self, energies: Energies) -> np.ndarray:
        return (energies.nodes * -np.expm1(-0.6 * self.material.attenuation(energies.nodes)))[None]


DETECTORS = {
    "energy": (Integrating(), 20.0),
    "65..90": (Window(65.0, 90.0), 65.0),
    "50..65": (Window(50.0, 65.0), 50.0),
    "20..34": (Window(20.0, 34.0), 20.0),
}


def tube(kvp: float) -> Source:
    return Source.tube(kvp, 1e5, 12, [Filter(Material("Al", composition="Al"), 2.5)])


def candidates(rule: str, integrand: Integrand, high: np.ndarray) -> list:
    """Transmissions of one rule, ever larger."""
    if rule == "midpoint":
        whole = Integrand(integrand.source, integrand.detector, integrand.columns, 20.0)
        return [rules.midpoint(whole, count, 140.0) for count in NODES]
    if rule == "compressed":
        exact = rules.fine(integrand)
        return [exact.compress(0 * high, high, tolerance, thorough=True)[0] for tolerance in TOLERANCES]
    if rule == "gauss":
        return [rules.gauss(integrand, count) for count in (*range(1, 11), 12, 15, 20, 30)]
    width = integrand.source.maximum - integrand.low
    return [rules.snapped(integrand, width / count) for count in np.unique(np.geomspace(1, 1024, 25).astype(int))]


def row(rule: str, integrand: Integrand, high: np.ndarray) -> str:
    rays = sample_box(np.array([0 * high, high]), 2000, np.random.default_rng(99))
    wanted = rules.fine(integrand).log_projection(rays)
    models = candidates(rule, integrand, high)
    errors = [model.log_projection(rays) - wanted for model in models]
    cells = []
    for i, most in enumerate(NODES):
        fitting = [k for k, m in enumerate(models) if len(m.weights) <= most] if rule != "midpoint" else [i]
        best = min(fitting, key=lambda k: np.abs(errors[k]).max(), default=None)
        if best is None:
            cells.append(f"{'-':>22}")
            continue
        worst, rms = np.abs(errors[best]).max(), np.sqrt((errors[best] ** 2).mean())
        cells.append(f"{len(models[best].weights):>4}{worst:>9.1e} ({rms:.0e})")
    return "".join(cells)


def accuracy() -> None:
    print(f"{'kVp':<5}{'channel':<9}{'object':<13}{'rule':<11}" + "".join(f"{f'up to {n} nodes':>22}" for n in NODES))
    for kvp in (120.0, 80.0, 140.0):
        source = tube(kvp)
        for channel, (detector, low) in DETECTORS.items():
            for name, count in OBJECTS.items():
                if kvp != 120 and (count != 4 or channel != "energy"):
                    continue
                materials, high = zip(*list(MATERIALS.values())[:count], strict=True)
                integrand = Integrand(source, detector, materials, low)
                for rule in rules.RULES:
                    cells = row(rule, integrand, np.array(high))
                    print(f"{kvp:<5g}{channel:<9}{name:<13}{rule:<11}{cells}", flush=True)


def speed() -> None:
    materials, high = zip(*MATERIALS.values(), strict=True)
    integrand = Integrand(tube(120), DETECTORS["energy"][0], materials, 20.0)
    rays = np.random.default_rng(0).random((65536, 4)) * high
    print("\nfour columns, 65536 rays, one thread: nodes, ns per ray for counts, for counts and their derivatives")
    for count in (8, 16, 32, 64, 128, 512):
        model = rules.midpoint(integrand, count)
        took = []
        for run in (model.expected, model.expected_and_jacobian):
            run(rays)
            began = time.perf_counter()
            for _ in range(3):
                run(rays)
            took.append((time.perf_counter() - began) / 3 / len(rays) * 1e9)
        print(f"{len(model.weights):>6}{took[0]:>8.0f}{took[1]:>8.0f}")


def choice() -> None:
    materials, high = zip(*MATERIALS.values(), strict=True)
    print("\n`cheapest`, 120 kVp, all four materials: nodes, worst error and seconds to find them")
    print(f"{'channel':<9}{'tolerance':>10}{'free nodes':>34}{'nodes that are energies':>34}")
    for channel, (detector, low) in DETECTORS.items():
        integrand = Integrand(tube(120), detector, materials, low)
        for tolerance in (1e-3, 1e-4):
            cells = []
            for which in (rules.RULES, ("snapped", "gauss")):
                began = time.perf_counter()
                found = rules.cheapest(integrand, np.zeros(4), np.array(high), tolerance, which)
                took = time.perf_counter() - began
                cells.append(f"{found.rule:>14}{len(found):>5}{found.error:>9.0e}{took:>5.1f}s")
            print(f"{channel:<9}{tolerance:>10.0e}" + "".join(cells), flush=True)


def conditioning() -> None:
    edges = [("sigmoid", 33.17, 1.0), ("sigmoid", 33.17, 1 / 0.3), ("sigmoid", 63.0, 1.0), ("step", 63.0, 0.0)]
    edges += [("sigmoid", 80.7, 1.0)]
    plain = BasisFunction("photoelectric"), BasisFunction("compton")
    bases = {"photoelectric, compton": Basis(plain)}
    for kind, edge, width in edges:
        third = BasisFunction(kind, edge_energy=edge, edge_width=width)
        bases[f"+ {kind} {edge:g} keV, width {width:.2g}"] = Basis((*plain, third))
    bases["+ element I"] = Basis((*plain, BasisFunction("element", element="I")))
    energies, photons = tube(120).sampled(tube(120).grid(20.0, 64))
    weights = photons * DETECTORS["energy"][0].response(energies)[0]
    print("\ncondition number over the detected spectrum, 120 kVp: raw basis, conditioned basis")
    for name, basis in bases.items():
        raw = basis.evaluate(energies.nodes)
        inner = conditioning_of(raw, weights).columns(raw)
        numbers = [np.linalg.cond(columns * np.sqrt(weights / weights.sum())) for columns in (raw, inner)]
        print(f"{name:<40}{numbers[0]:>10.1f}{numbers[1]:>8.3f}")


if __name__ == "__main__":
    accuracy()
    speed()
    choice()
    conditioning()
