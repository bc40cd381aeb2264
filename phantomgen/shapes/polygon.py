"""Extruded polygons."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from phantomgen.geometry.rotation import rotation_matrix
from phantomgen.shapes.base import Shape, Term, Triple, checked_lengths, checked_triple
from phantomgen.shapes.boolean import HalfSpace, Placed
from phantomgen.shapes.box import Box
from spectra.errors import InputError

Points = Float[np.ndarray, "corner 2"]

# No unit, relative to the square of the polygon's size; a smaller area is rounding.
FLAT = 1e-12
"""Area over squared extent below which rounding decides what is inside."""


@dataclass(frozen=True)
class Polygon(Shape):
    """Prism: a simple polygon in the x-y plane, extruded along z and then turned and moved.

    Parameters
    ----------
    points : corners (x, y) [mm], in either sense of rotation, not necessarily convex
    length : extent along z, half of it on either side [mm]
    center : where the origin of the points goes (x, y, z) [mm]
    rotation : angles about the fixed x, then y, then z axis [rad]
    """

    points: tuple[tuple[float, float], ...]
    length: float
    center: Triple = (0.0, 0.0, 0.0)
    rotation: Triple = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        points = np.asarray(self.points, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 2 or len(points) < 3 or not np.isfinite(points).all():
            raise InputError(f"polygon points must be at least three finite pairs, got {self.points!r}")
        object.__setattr__(self, "points", tuple((float(x), float(y)) for x, y in points))
        for name in ("center", "rotation"):
            object.__setattr__(self, name, checked_triple("polygon", name, getattr(self, name)))
        checked_lengths("polygon", "length", (self.length,))
        crossing = _crossing_edges(points)
        if crossing is not None:
            raise InputError(
                f"polygon edges {crossing[0]} and {crossing[1]} cross or touch: its outline must be simple"
            )
        if abs(_area(points)) <= FLAT * np.ptp(points, axis=0).max() ** 2:
            raise InputError("polygon points lie on one line: its outline must enclose an area")

    @property
    def terms(self) -> tuple[Term, ...]:
        """One term per triangle, each a box cut by its edges; one in all for a convex polygon."""
        corners = np.asarray(self.points)
        if _area(corners) < 0:
            corners = corners[::-1]
        pieces = [np.arange(len(corners))] if _is_convex(corners) else _triangles(corners)
        planes: dict[tuple[int, int], Term] = {}
        found = []
        for piece in pieces:
            part = corners[piece]
            low, high = part.min(axis=0), part.max(axis=0)
            (x, y), (width, depth) = (low + high) / 2, high - low
            box = Box((float(x), float(y), 0.0), (float(width), float(depth), self.length)).terms[0]
            found.append(
                box
                + tuple(_side(corners, int(a), int(b), planes) for a, b in zip(piece, np.roll(piece, -1), strict=True))
            )
        placed = Placed(_Terms(tuple(found)), rotation_matrix(self.rotation), np.asarray(self.center))
        return placed.terms

    @property
    def volume(self) -> float:
        """Volume [mm^3]."""
        return abs(_area(np.asarray(self.points))) * self.length


@dataclass(frozen=True)
class _Terms(Shape):
    """Terms as they are."""

    given: tuple[Term, ...]

    @property
    def terms(self) -> tuple[Term, ...]:
        return self.given


def _side(corners: Points, a: int, b: int, planes: dict):
    """Return the half space left of the edge from corner a to b; a shared edge cuts both neighbours identically."""
    if (b, a) in planes:
        return planes[b, a].opposite
    (dx, dy), (x, y) = corners[b] - corners[a], corners[a]
    length = np.hypot(dx, dy)
    plane = HalfSpace((float(dy), float(-dx), 0.0), float((dy * x - dx * y) / length)).terms[0][0]
    planes[a, b] = plane
    return plane


def _area(points: Points) -> float:
    """Area, positive for corners that run counter-clockwise [mm^2]."""
    x, y = points.T
    return float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) / 2)


def _turns(points: Points) -> Float[np.ndarray, " corner"]:
    """Cross product of the edges before and behind each corner."""
    before, behind = points - np.roll(points, 1, axis=0), np.roll(points, -1, axis=0) - points
    return before[:, 0] * behind[:, 1] - before[:, 1] * behind[:, 0]


def _is_convex(points: Points) -> bool:
    return bool((_turns(points) >= 0).all())


def _triangles(points: Points) -> list[np.ndarray]:
    """Triangulation of a simple counter-clockwise polygon by cutting off ears."""
    left, found = list(range(len(points))), []
    while len(left) > 3:
        for i in range(len(left)):
            ear = [left[i - 1], left[i], left[(i + 1) % len(left)]]
            others = [k for k in left if k not in ear]
            if _turns(points[ear])[1] > 0 and not _any_inside(points[ear], points[others]):
                break
        else:  # only corners without a turn are left
            i = int(np.argmin(np.abs(_turns(points[left]))))
            left.pop(i)
            continue
        found.append(np.array(ear))
        left.pop(i)
    return [*found, np.array(left)]


def _any_inside(triangle: Float[np.ndarray, "3 2"], points: Points) -> bool:
    """Return whether a triangle contains any of the points, its edges included."""
    edges = np.roll(triangle, -1, axis=0) - triangle
    offsets = points[:, None] - triangle
    return bool((edges[:, 0] * offsets[..., 1] - edges[:, 1] * offsets[..., 0] >= 0).all(axis=1).any())


def _crossing_edges(points: Points) -> tuple[int, int] | None:
    """Numbers of two edges that meet elsewhere than in a shared corner, if there are any."""
    n = len(points)
    ends = np.roll(points, -1, axis=0)

    def side(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> float:
        return np.sign((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))

    for i in range(n):
        for j in range(i + 2, n - (i == 0)):
            a, b, c, d = points[i], ends[i], points[j], ends[j]
            apart = (np.maximum(a, b) < np.minimum(c, d)) | (np.maximum(c, d) < np.minimum(a, b))
            if not apart.any() and side(a, b, c) * side(a, b, d) <= 0 and side(c, d, a) * side(c, d, b) <= 0:
                return i, j
    return None
