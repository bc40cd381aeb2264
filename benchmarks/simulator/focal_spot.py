"""How many points a focal spot needs: error at edges, and time of a view.

    python -m benchmarks.simulator.focal_spot [PIXELS]

First the worst there is, by closed forms: an opaque edge anywhere in any direction, and an opaque corner along rows and
columns, seen by square pixels through a uniform spot that blurs them over `blur` pixels; the error is the largest one,
in parts of the open beam. `n x n` are products of Gauss-Legendre rules.

Then views of objects at magnification 1.6 that let 10 to 80 % through, on panels of PIXELS x PIXELS, 0.8 mm each,
against a lattice of 985 points; `cheap` takes the Gauss rules inside a pixel from one level lower. Times are the least
of three.
"""

import sys
import time

import numpy as np

from phantomgen.effects import FocalSpot
from phantomgen.effects.focal_spot import spot_lattice
from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry
from phantomgen.ops.expected_counts import RULES, Sampling, Spectrum, expected_counts
from phantomgen.shapes import Cylinder, Sphere, solids_of

SOD, SDD, PITCH = 500.0, 800.0, 0.8
SPECTRUM = Spectrum(np.array([[0.02], [0.06]]), np.array([1.0]), np.array([0, 1]))
OBJECTS = {"cylinder": (Cylinder((0, 0, 0), 12, 40), 1), "sphere": (Sphere((1, 2, 3), 9), 1)}
CHEAP = (RULES[0], *RULES[:-1])
POINTS = (5, 13, 29, 53, 89)
BLURS = (0.25, 0.5, 1.0, 2.0, 4.0)


def view(frames: np.ndarray, pixels: int, solids, rules=RULES) -> np.ndarray:
    """Average over source points."""
    total = np.zeros((pixels, pixels))
    for frame in frames:
        total += expected_counts(frame, pixels, pixels, solids, SPECTRUM, sampling=Sampling(rules=rules)).counts[0]
    return total / len(frames)


def half_square(x: np.ndarray) -> np.ndarray:
    return np.maximum(x, 0) ** 2 / 2


def seen_past_edge(place: np.ndarray, c: float, s: float) -> np.ndarray:
    """Part of a unit pixel beyond a straight edge at some distance from its centre, with the normal (c, s)."""
    a, b = (c + s) / 2, (c - s) / 2
    sums = half_square(place + a) - half_square(place + b) - half_square(place - b) + half_square(place - a)
    return sums / (c * s)


def worst(points: np.ndarray, weights: np.ndarray, blur: float) -> float:
    """Largest error for edges in all directions, and for a corner."""
    fine = (np.arange(300) + 0.5) / 300 - 0.5
    place, largest = np.linspace(-0.75, 0.75, 241) * max(blur, 1.0), []
    for angle in np.linspace(1e-4, np.pi / 4, 24):
        c, s = np.cos(angle), np.sin(angle)
        share, limits = np.histogram(c * fine[:, None] + s * fine, 400)
        middle = (limits[1:] + limits[:-1]) / 2
        exact = share / share.sum() @ seen_past_edge(place - blur * middle[:, None], c, s)
        found = weights @ seen_past_edge(place - blur * (points @ [c, s])[:, None], c, s)
        largest.append(np.abs(found - exact).max())
    place = np.linspace(-1, 1, 61) * (0.7 * blur + 0.6)
    exact = np.clip(place[:, None] - blur * fine + 0.5, 0, 1).mean(axis=1)
    across, down = (np.clip(place[:, None] - blur * x + 0.5, 0, 1) for x in points.T)
    return max(*largest, np.abs((across * weights) @ down.T - np.outer(exact, exact)).max())


def products(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Points and weights of n x n Gauss-Legendre nodes on [-1/2, 1/2]^2."""
    node, weight = np.polynomial.legendre.leggauss(n)
    return np.stack(np.meshgrid(node / 2, node / 2), axis=-1).reshape(-1, 2), np.outer(weight, weight).ravel() / 4


def print_worst() -> None:
    rules = {f"{n} points": (spot_lattice(n), np.full(n, 1 / n)) for n in (*POINTS, 169)}
    rules |= {f"{n} x {n}": products(n) for n in (3, 5, 7)}
    print(f"{'blur':>6}" + "".join(f"{name:>12}" for name in rules) + f"{'default':>9}")
    for blur in BLURS:
        row = "".join(f"{worst(*rule, blur):>12.1e}" for rule in rules.values())
        print(f"{blur:>6.2f}{row}{FocalSpot(1.0, 1.0).points_for(blur):>9}", flush=True)


def main(pixels: int) -> None:
    print_worst()
    frame = Geometry.circular(SOD, SDD, np.zeros(1), Panel(pixels, pixels, PITCH)).ray_frames()[0]
    names = [*(f"{n} points" for n in POINTS), "29 cheap"]
    print(f"\n{'object':<12}{'shape':<10}{'blur':>6}" + "".join(f"{name:>12}" for name in names) + f"{'default':>9}")
    for name, part in OBJECTS.items():
        for shape in ("uniform", "gaussian"):
            for blur in BLURS:
                size = blur * PITCH / (SDD / SOD - 1)
                spot = FocalSpot(size, size, shape)

                def seen(n: int, rules=RULES, spot=spot, part=part) -> np.ndarray:
                    return view(spot.frames(frame, n), pixels, solids_of([part]), rules)

                exact = seen(985)
                errors = [*(np.abs(seen(n) - exact).max() for n in POINTS), np.abs(seen(29, CHEAP) - exact).max()]
                row = "".join(f"{error:>12.1e}" for error in errors)
                print(f"{name:<12}{shape:<10}{blur:>6.2f}{row}{spot.points_for(blur):>9}", flush=True)
    solids = solids_of(list(OBJECTS.values()))
    for rules in (RULES, CHEAP):
        times = []
        for _ in range(3):
            began = time.perf_counter()
            expected_counts(frame, pixels, pixels, solids, SPECTRUM, sampling=Sampling(rules=rules))
            times.append(time.perf_counter() - began)
        print(f"{'cheap' if rules is CHEAP else 'usual'} rules: {min(times) * 1e3:.1f} ms per point")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 48)
