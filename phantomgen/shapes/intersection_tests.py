"""Tests whether shapes have a common interior, and whether one encloses another."""

from collections.abc import Iterator, Sequence
from itertools import product

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize

from phantomgen.ops.primitives import BALL, BOX, CONE, CYLINDER, HALFSPACE, MESH, TORUS
from phantomgen.shapes.base import Bounds, Part, Shape

# Depth, relative to the primitives, below which a common interior counts as none: shapes that touch do not meet.
_TOUCH = 1e-7
# Points by which non-convex parts are judged; what they miss is smaller than about 1e-4 of the box around it.
_POINTS = 20_000
# Points that are enough where both shapes are convex.
_GLANCE = 64

_CORNERS = np.array(list(product((-1.0, 1.0), repeat=3)))
# Local coordinates whose norm is at most 1 inside a convex primitive.
_NORMS = {BALL: ([0, 1, 2],), CYLINDER: ([0, 1], [2]), BOX: ([0], [1], [2])}


def meet(shapes: Sequence[Shape]) -> bool:
    """Return whether shapes have a common interior.

    Exact for what is made of convex primitives and planes: there the point that lies deepest in all of them is sought.
    Where a part is a torus, a mesh or something cut out, random points decide, and a common interior that fills less
    than about 1e-4 of the box around it is missed.

    Parameters
    ----------
    shapes : the shapes

    Returns
    -------
    True where they have
    """
    return any(_common([part for term in choice for part in term]) for choice in product(*(s.terms for s in shapes)))


def encloses(outer: Shape, inner: Shape) -> bool:
    """Return whether `inner` certainly lies in `outer`; False where that is hard to decide.

    Parameters
    ----------
    outer : outer shape
    inner : inner shape

    Returns
    -------
    True where it certainly does
    """
    return all(
        any(all(any(_part_encloses(part, core) for core in term) for part in whole) for whole in outer.terms)
        for term in inner.terms
    )


def _common(parts: Sequence[Part]) -> bool:
    """Return whether all parts together leave a space."""
    boxes = [part.bounds for part in parts if part.inside and part.kind != HALFSPACE]
    low, high = np.max([box[0] for box in boxes], axis=0), np.min([box[1] for box in boxes], axis=0)
    if (high - low <= 0).any():
        return False
    convex = all(part.kind == HALFSPACE or (part.inside and part.kind in (*_NORMS, CONE)) for part in parts)
    rng = np.random.default_rng(0)
    unit = np.concatenate([np.full((1, 3), 0.5), rng.random((_GLANCE if convex else _POINTS, 3))])
    points = low + unit * (high - low)
    if np.logical_and.reduce([part.contains(points) for part in parts]).any():
        return True
    return convex and _depth(parts, (low, high)) > _TOUCH


def _depth(parts: Sequence[Part], box: Bounds) -> float:
    """Compute the depth of the deepest point in all of some convex parts, relative to their size; negative outside."""
    low, high = box
    middle, half = (low + high) / 2, (high - low) / 2

    def excess(variables: Float[np.ndarray, " 4"]) -> Float[np.ndarray, " condition"]:
        point = middle + half * variables[:3]
        values = [value for part in parts for value in _values(part, point, float(np.linalg.norm(half)))]
        return variables[3] - np.array(values)

    start = np.array([0.0, 0.0, 0.0, 0.0])
    start[3] = -excess(start).min()
    found = minimize(
        lambda v: v[3],
        start,
        jac=lambda _: np.array([0.0, 0.0, 0.0, 1.0]),
        constraints={"type": "ineq", "fun": excess},
        method="SLSQP",
        options={"maxiter": 200, "ftol": 1e-10},
    ).x
    found[3] = 0.0
    return float(excess(found).min())


def _values(part: Part, point: Float[np.ndarray, " 3"], size: float) -> list[float]:
    """Convex functions of a point that are negative inside a part."""
    local = part.local[:, :3] @ point + part.local[:, 3]
    if part.kind == HALFSPACE:
        return [float(local[2] if part.inside else -local[2]) / size]
    if part.kind == CONE:
        return [float(np.hypot(local[0], local[1]) - local[2]), float(local[2] - 1)]
    return [float(np.sum(local[axes] ** 2) - 1) for axes in _NORMS[part.kind]]


def _part_encloses(outer: Part, inner: Part) -> bool:
    """Return whether all of a primitive lies in another one, or on the right side of a plane."""
    if not inner.inside or inner.kind == HALFSPACE or (outer.kind != HALFSPACE and not outer.inside):
        return False
    axes = np.linalg.inv(inner.local[:, :3])
    turn = outer.local[:, :3] @ axes
    shift = outer.local[:, 3] - turn @ inner.local[:, 3]
    for center, columns in _hull(inner):
        offset, matrix = shift + turn @ center, turn @ columns
        if outer.kind == HALFSPACE:
            side = 1.0 if outer.inside else -1.0
            if side * offset[2] + np.linalg.norm(matrix[2]) > 0:
                return False
        elif outer.kind not in _NORMS or any(_farthest(offset[i], matrix[i]) > 1 + 1e-12 for i in _NORMS[outer.kind]):
            return False
    return True


def _hull(part: Part) -> Iterator[tuple[Float[np.ndarray, " 3"], Float[np.ndarray, "3 axis"]]]:
    """Balls, discs and points in local coordinates whose convex hull holds the primitive: centre and half axes."""
    disc, up = np.eye(3)[:, :2], np.array([0.0, 0.0, 1.0])
    if part.kind == BALL:
        yield np.zeros(3), np.eye(3)
    elif part.kind == CONE:
        yield from ((np.zeros(3), np.zeros((3, 0))), (up, disc))
    elif part.kind in (CYLINDER, TORUS):
        height = up if part.kind == CYLINDER else part.tube * up
        yield from ((-height, disc), (height, disc))
    elif part.kind in (BOX, MESH):
        yield from ((corner, np.zeros((3, 0))) for corner in _CORNERS)


def _farthest(offset: Float[np.ndarray, " row"], matrix: Float[np.ndarray, "row axis"]) -> float:
    """Largest norm of ``offset + matrix @ u`` over all u with norm at most 1.

    The square is the least value over m >= max(d) of |offset|^2 + m + sum_i g_i^2 / (m - d_i), with d the eigenvalues
    of matrix^T matrix and g its eigenvectors times matrix^T offset (the dual of a trust-region problem: Boyd &
    Vandenberghe 2004, Convex Optimization, appendix B.1); bisection ends above it.
    """
    if matrix.shape[1] == 0 or not matrix.any():
        return float(np.linalg.norm(offset))
    values, vectors = np.linalg.eigh(matrix.T @ matrix)
    pull = vectors.T @ (matrix.T @ offset)
    low, high = 0.0, float(np.linalg.norm(pull))
    if high == 0:
        return float(np.sqrt(offset @ offset + values[-1]))
    for _ in range(60):
        middle = (low + high) / 2
        if np.sum((pull / (values[-1] - values + middle)) ** 2) > 1:
            low = middle
        else:
            high = middle
    gaps = values[-1] - values + high
    return float(np.sqrt(offset @ offset + values[-1] + high + np.sum(pull**2 / gaps)))
