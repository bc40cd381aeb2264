"""Silhouettes of shapes as quadratic forms in panel coordinates.

Rays are given by w = (1, u, v): origin ``o = O w`` and direction ``d = D w``, where either O or D is constant (a point
source, or parallel rays). Then the moment ``m = o x d`` is linear in w too; in local coordinates of a unit primitive

=========  ==========================================================  ============================================
primitive  forms                                                       zero where
=========  ==========================================================  ============================================
ball       d.d - m.m                                                   a ray touches the sphere
cylinder   dx^2 + dy^2 - mz^2                                          a ray touches the mantle
cylinder   dz^2 - (h dx - my)^2 - (h dy + mx)^2, h = +1, -1            a ray meets a rim
box        mk^2 - (di + dj)^2, mk^2 - (di - dj)^2, (i, j, k) cyclic    a ray meets one of two opposite edges along k
cone       mx^2 + my^2 - mz^2                                          a ray touches the mantle
cone       dz^2 - (dx - my)^2 - (dy + mx)^2                            a ray meets the rim
=========  ==========================================================  ============================================

Half-spaces have no silhouette, and that of a torus is no conic.

(Plücker coordinates: two lines meet where the mixed product of directions and moments vanishes.) Inside the first two,
path lengths grow like the square root of the form; the others mark kinks, or steps where a face is seen edge on.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int64

from phantomgen.ops.primitives import BALL, BOX, CONE, CYLINDER, HALFSPACE

# Relative size below which a form is rounding noise: every ray, or none, is singular (a mantle seen along its axis).
_ZERO_FORM = 1e-26


class Silhouettes(NamedTuple):
    """Conics of one view.

    Parameters
    ----------
    forms : (a, b, c, d, e, f) of q = a + b u + c v + d u^2 + e u v + f v^2, scaled to a largest value of 1
    shapes : the shape that each form belongs to
    roots : 1 where path lengths grow like sqrt(q) inside (q > 0), else 0
    bounds : lowest u, highest u, lowest v, highest v of each shape; infinite for one that reaches behind the source
    """

    forms: Float[np.ndarray, "form 6"]
    shapes: Int64[np.ndarray, " form"]
    roots: Float[np.ndarray, " form"]
    bounds: Float[np.ndarray, "shape 4"]


def cone_silhouettes(
    frame: Float[np.ndarray, "4 3"], kinds: Int64[np.ndarray, " shape"], locals_: Float[np.ndarray, "shape 3 4"]
) -> Silhouettes:
    """Silhouettes for rays ``frame[0] + t (frame[1] + u frame[2] + v frame[3])``."""
    origin = np.zeros((3, 3))
    origin[:, 0] = frame[0]
    return _silhouettes(origin, frame[1:].T, kinds, locals_, _projected_bounds(frame, kinds, locals_))


def parallel_silhouettes(
    frame: Float[np.ndarray, "4 3"], kinds: Int64[np.ndarray, " shape"], locals_: Float[np.ndarray, "shape 3 4"]
) -> Silhouettes:
    """Silhouettes for parallel rays ``frame[1] + u frame[2] + v frame[3] + t frame[0]``; bounds are not looked for."""
    direction = np.zeros((3, 3))
    direction[:, 0] = frame[0]
    bounds = np.tile([-np.inf, np.inf, -np.inf, np.inf], (len(kinds), 1))
    return _silhouettes(frame[1:].T, direction, kinds, locals_, bounds)


def _silhouettes(
    origin: Float[np.ndarray, "3 3"],
    direction: Float[np.ndarray, "3 3"],
    kinds: Int64[np.ndarray, " shape"],
    locals_: Float[np.ndarray, "shape 3 4"],
    bounds: Float[np.ndarray, "shape 4"],
) -> Silhouettes:
    forms, shapes, roots = [np.empty((0, 6))], [], []
    for s, (kind, m) in enumerate(zip(kinds, locals_, strict=True)):
        d, o = m[:, :3] @ direction, m[:, :3] @ origin
        o[:, 0] += m[:, 3]
        moment = np.cross(o[:, :1], d, axis=0)
        moment[:, 1:] += np.cross(o[:, 1:], d[:, :1], axis=0)
        found, root = _primitive_forms(kind, d, moment)
        size = np.abs(found).max(axis=(1, 2))
        kept = size > _ZERO_FORM * max(np.abs(d).max(), np.abs(moment).max()) ** 2
        q = found[kept] / size[kept, None, None]
        forms.append(np.stack([q[:, 0, 0], 2 * q[:, 0, 1], 2 * q[:, 0, 2], q[:, 1, 1], 2 * q[:, 1, 2], q[:, 2, 2]], 1))
        shapes += [s] * len(q)
        roots += list(root[kept])
    return Silhouettes(np.concatenate(forms), np.array(shapes, np.int64), np.array(roots, np.float64), bounds)


def _primitive_forms(
    kind: int, d: Float[np.ndarray, "3 3"], m: Float[np.ndarray, "3 3"]
) -> tuple[Float[np.ndarray, "form 3 3"], Bool[np.ndarray, " form"]]:
    """Forms of one primitive, and whether each is a tangent; direction and moment come as rows over (1, u, v)."""

    def square(row: np.ndarray) -> np.ndarray:
        return np.outer(row, row)

    if kind == BALL:
        return (d.T @ d - m.T @ m)[None], np.array([True])
    if kind == CYLINDER:
        mantle = square(d[0]) + square(d[1]) - square(m[2])
        rims = [square(d[2]) - square(h * d[0] - m[1]) - square(h * d[1] + m[0]) for h in (-1.0, 1.0)]
        return np.stack([mantle, *rims]), np.array([True, False, False])
    if kind == CONE:
        mantle = square(m[0]) + square(m[1]) - square(m[2])
        rim = square(d[2]) - square(d[0] - m[1]) - square(d[1] + m[0])
        return np.stack([mantle, rim]), np.array([True, False])
    if kind != BOX:
        return np.empty((0, 3, 3)), np.empty(0, np.bool_)
    cyclic = [(1, 2, 0), (2, 0, 1), (0, 1, 2)]
    edges = [square(m[k]) - square(d[i] + sign * d[j]) for i, j, k in cyclic for sign in (-1.0, 1.0)]
    return np.stack(edges), np.zeros(6, np.bool_)


def _projected_bounds(
    frame: Float[np.ndarray, "4 3"], kinds: Int64[np.ndarray, " shape"], locals_: Float[np.ndarray, "shape 3 4"]
) -> Float[np.ndarray, "shape 4"]:
    """Panel rectangle around the projection of the cube that encloses each bounded primitive."""
    corners = np.array(np.meshgrid(*[(-1.0, 1.0)] * 3)).reshape(3, 8)
    bounds = np.tile([-np.inf, np.inf, -np.inf, np.inf], (len(locals_), 1))
    for s in np.flatnonzero(kinds != HALFSPACE):
        m = locals_[s]
        world = np.linalg.solve(m[:, :3], corners - m[:, 3:])
        depth, u, v = np.linalg.solve(frame[1:].T, world - frame[0][:, None])
        if depth.min() > 1e-9:
            u, v = u / depth, v / depth
            bounds[s] = u.min(), u.max(), v.min(), v.max()
    return bounds
