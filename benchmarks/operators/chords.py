"""Chords of every shape against extended precision: random rays, a fifth of them grazing.

    python -m benchmarks.operators.chords [RAYS [SHAPE ...]]

The reference knows the implicit functions only, in long double (64-bit mantissa): it cuts a ray where one of them
changes sign on a fine grid or dips below zero between its points, bisects to the last digit, and adds the pieces whose
middle lies inside. Errors are relative to the shape's diameter. Grazing chords shorter than 1e-6 of it stand apart:
there a ray's rounding, 1e-16 of its distance, moves the chord by up to the square root of that.
"""

import sys
import time

import numpy as np

from phantomgen.ops.primitives import BALL, BOX, CONE, CYLINDER, HALFSPACE, TORUS
from phantomgen.ops.trace import trace
from phantomgen.shapes import (
    Box,
    Capsule,
    Cone,
    Cylinder,
    Difference,
    Ellipsoid,
    HalfSpace,
    Intersection,
    Polygon,
    Shape,
    Sphere,
    Torus,
    Tube,
    solids_of,
)

L = np.longdouble
SHORT = 1e-6
SHAPES: dict[str, Shape] = {
    "sphere": Sphere((1, 2, 3), 30.0),
    "ellipsoid": Ellipsoid((1, 2, 3), (10.0, 20.0, 30.0), (0.3, 0.5, 0.7)),
    "elliptic cylinder": Cylinder((1, 2, 3), (20.0, 10.0), 50.0, (1, 2, 3)),
    "box": Box((1, 2, 3), (20.0, 30.0, 40.0), (0.3, 0.5, 0.7)),
    "tube": Tube((1, 2, 3), 30.0, 29.0, 50.0, (1, 2, 3)),
    "capsule": Capsule((1, 2, 3), 10.0, 40.0, (1, 2, 3)),
    "cone": Cone((1, 2, 3), (0.0, 20.0), 50.0, (1, 2, 3)),
    "frustum": Cone((1, 2, 3), (20.0, 10.0), 50.0, (1, 2, 3)),
    "torus": Torus((1, 2, 3), 30.0, 10.0, (1, 2, 3)),
    "extruded polygon": Polygon(
        ((0, 30), (8, 8), (30, 0), (8, -8), (0, -30), (-8, -8), (-30, 0), (-8, 8)), 40.0, (1, 2, 3)
    ),
    "wedge": Intersection((Cylinder((0, 0, 0), 30.0, 20.0), HalfSpace((1, 0, 0), 5.0), HalfSpace((-1, 2, 0), 5.0))),
    "difference": Difference(Sphere((0, 0, 0), 30.0), (Cylinder((0, 0, 0), 10.0, 80.0, (1, 1, 1)),)),
}


def implicit(part, x, y, z):
    """Functions of which all are negative inside a primitive, as rows."""
    radial = x * x + y * y
    return {
        BALL: lambda: [radial + z * z - 1],
        CYLINDER: lambda: [radial - 1, z * z - 1],
        BOX: lambda: [x * x - 1, y * y - 1, z * z - 1],
        CONE: lambda: [radial - z * z, z * (z - 1)],
        HALFSPACE: lambda: [z],
        TORUS: lambda: [(np.sqrt(radial) - 1 + L(part.tube)) ** 2 + z * z - L(part.tube) ** 2],
    }[part.kind]()


def values(shape: Shape, origin, direction, t):
    """All implicit functions along rays, as rows, in extended precision."""
    found = []
    for term in shape.terms:
        for part in term:
            m = part.local.astype(L)
            o, d = origin @ m[:, :3].T + m[:, 3], direction @ m[:, :3].T
            point = o[:, None] + t[..., None] * d[:, None]
            found += implicit(part, *np.moveaxis(point, -1, 0))
    return np.array(found)


def within(shape: Shape, found) -> np.ndarray:
    """Whether points lie inside, from the signs of the functions."""
    inside, row = np.zeros(found.shape[1:], np.bool_), 0
    for term in shape.terms:
        holds = np.ones(found.shape[1:], np.bool_)
        for part in term:
            count = {BALL: 1, CYLINDER: 2, BOX: 3, CONE: 2, HALFSPACE: 1, TORUS: 1}[part.kind]
            holds &= (found[row : row + count] < 0).all(axis=0) == part.inside
            row += count
        inside |= holds
    return inside


def exact(shape: Shape, origin, direction, grid: int = 400, batch: int = 500) -> np.ndarray:
    """Path lengths in extended precision of rays whose middle lies within the bounds of the shape."""
    lengths = []
    low, high = shape.bounds
    reach = min(0.5, np.linalg.norm(high - low) / np.linalg.norm(direction[0]))
    for first in range(0, len(origin), batch):
        o, d = origin[first : first + batch].astype(L), direction[first : first + batch].astype(L)
        t = np.broadcast_to(L(0.5) + np.linspace(L(-reach), L(reach), grid + 1), (len(o), grid + 1))
        found = values(shape, o, d, t)
        which, ray, cell = np.nonzero((found[..., 1:] < 0) != (found[..., :-1] < 0))
        ends = [(which, ray, t[ray, cell], t[ray, cell + 1]), *dips(shape, o, d, t, found)]
        which, ray, low, high = (np.concatenate(columns) for columns in zip(*ends, strict=True))
        begins = values_at(shape, o, d, ray, low, which) < 0
        for _ in range(66):
            middle = (low + high) / 2
            moved = (values_at(shape, o, d, ray, middle, which) < 0) == begins
            low, high = np.where(moved, middle, low), np.where(moved, high, middle)
        cuts = sorted_cuts(len(o), ray, low)
        inside = within(shape, values(shape, o, d, (cuts[:, 1:] + cuts[:, :-1]) / 2))
        lengths.append((np.diff(cuts) * inside).sum(axis=1) * np.sqrt((d * d).sum(axis=1)))
    return np.concatenate(lengths)


def sorted_cuts(count: int, ray, t) -> np.ndarray:
    """Cuts of each ray between 0 and 1, ascending, the short rows filled with ones."""
    order = np.lexsort((t, ray))
    ray, t = ray[order], t[order]
    places = np.arange(len(ray)) - np.searchsorted(ray, ray)
    cuts = np.ones((count, int(places.max(initial=-1)) + 3), L)
    cuts[:, 0] = 0
    cuts[ray, places + 1] = t
    return cuts


def dips(shape: Shape, o, d, t, found):
    """Brackets of both roots where a function dips below zero between points of the grid."""
    middle = found[..., 1:-1]
    which, ray, cell = np.nonzero((middle >= 0) & (middle <= found[..., 2:]) & (middle <= found[..., :-2]))
    first, last = t[ray, cell], t[ray, cell + 2]
    low, high = first.copy(), last.copy()
    for _ in range(130):
        left, right = low + (high - low) * L(0.382), low + (high - low) * L(0.618)
        smaller = values_at(shape, o, d, ray, left, which) < values_at(shape, o, d, ray, right, which)
        low, high = np.where(smaller, low, left), np.where(smaller, right, high)
    bottom = (low + high) / 2
    below = values_at(shape, o, d, ray, bottom, which) < 0
    sides = ((first, bottom), (bottom, last))
    return [(which[below], ray[below], begin[below], end[below]) for begin, end in sides]


def values_at(shape: Shape, o, d, ray, t, which):
    """One function each at one point of each of some rays."""
    if not len(ray):
        return np.zeros(0, L)
    return values(shape, o[ray], d[ray], t[:, None])[which, np.arange(len(ray)), 0]


def rays_of(shape: Shape, count: int, rng: np.random.Generator):
    """Rays through the bounds from far away; a fifth of them moved sideways until they all but touch the surface."""
    low, high = shape.bounds
    target = rng.uniform(low, high, (count, 3))
    direction = rng.normal(size=(count, 3))
    direction *= 400 / np.linalg.norm(direction, axis=1, keepdims=True)
    origin = target - direction / 2
    grazing = slice(0, count // 5)
    side = np.cross(direction[grazing], rng.normal(size=(count // 5, 3)))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    solids = solids_of([(shape, 0)])
    near, far = np.zeros(count // 5), np.full(count // 5, 150.0)
    for _ in range(rng.integers(25, 35)):
        middle = (near + far) / 2
        hit = trace(origin[grazing] + middle[:, None] * side, direction[grazing], solids, 1)[:, 0] > 0
        near, far = np.where(hit, middle, near), np.where(hit, far, middle)
    origin[grazing] += near[:, None] * side
    return origin, direction


def main(count: int, names: list[str]) -> None:
    print(
        f"{'shape':<20}{'rays':>8}{'hits':>8}{'worst':>10}{'rms':>10}{'grazing worst':>15}{'shortest':>10}"
        f"{'of rays':>8}{'NaN':>5}{'ns/ray':>8}"
    )
    for name in names or SHAPES:
        shape = SHAPES[name]
        rng = np.random.default_rng(0)
        origin, direction = rays_of(shape, count, rng)
        solids = solids_of([(shape, 0)])
        trace(origin[:1], direction[:1], solids, 1)
        began = time.perf_counter()
        found = trace(origin, direction, solids, 1)[:, 0]
        took = time.perf_counter() - began
        low, high = shape.bounds
        diameter = np.linalg.norm(high - low)
        right = exact(shape, origin, direction)
        error = np.abs(found - right).astype(float) / diameter
        grazing, rest = error[: count // 5], error[count // 5 :]
        shortest = right[: count // 5] < SHORT * diameter
        print(
            f"{name:<20}{count:>8}{(found > 0).sum():>8}{rest.max():>10.1e}{np.sqrt((rest**2).mean()):>10.1e}"
            f"{grazing[~shortest].max(initial=0):>15.1e}{grazing[shortest].max(initial=0):>10.1e}{shortest.sum():>8}"
            f"{np.isnan(found).sum():>5}{took / count * 1e9:>8.0f}",
            flush=True,
        )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 10_000, sys.argv[2:])
