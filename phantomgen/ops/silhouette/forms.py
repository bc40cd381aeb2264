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

Half-spaces have no silhouette, and that of a torus is a conic within a pixel only (`rings`).

(Plücker coordinates: two lines meet where the mixed product of directions and moments vanishes.) Inside the first two,
path lengths grow like the square root of the form; the others mark kinks, or steps where a face is seen edge on.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int64

from phantomgen.ops.primitives import BALL, BOX, CONE, CYLINDER, HALFSPACE, TORUS
from phantomgen.ops.solids import half_axes

# No unit, relative to squares of directions and moments; a smaller form is rounding, (1e-13)^2: every ray, or none, is
# singular (a mantle seen along its axis).
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
    """Compute the silhouettes for rays ``frame[0] + t (frame[1] + u frame[2] + v frame[3])``.

    Parameters
    ----------
    frame : source, vector from there to the centre of pixel (0, 0), column step, row step (x, y, z) [mm]
    kinds, locals_ : code of each primitive, and its map from world [mm] to local coordinates

    Returns
    -------
    silhouettes and bounds
    """
    origin = np.zeros((3, 3))
    origin[:, 0] = frame[0]
    return _silhouettes(origin, frame[1:].T, kinds, locals_, cone_bounds(frame, kinds, locals_))


def parallel_silhouettes(
    frame: Float[np.ndarray, "4 3"], kinds: Int64[np.ndarray, " shape"], locals_: Float[np.ndarray, "shape 3 4"]
) -> Silhouettes:
    """Compute the silhouettes for parallel rays ``frame[1] + u frame[2] + v frame[3] + t frame[0]``.

    Parameters
    ----------
    frame : direction, position of the ray (0, 0), column step, row step (x, y, z) [mm]
    kinds, locals_ : as in `cone_silhouettes`

    Returns
    -------
    silhouettes and bounds
    """
    direction = np.zeros((3, 3))
    direction[:, 0] = frame[0]
    return _silhouettes(frame[1:].T, direction, kinds, locals_, parallel_bounds(frame, kinds, locals_))


def layer_curves(
    frame: Float[np.ndarray, "4 3"], kinds: Int64[np.ndarray, " shape"], locals_: Float[np.ndarray, "shape 3 4"]
) -> Silhouettes:
    """Compute all curves where path lengths of parallel rays between two planes have a kink.

    They are silhouettes, as far as they may lie between the planes where rays begin and end, and the curves along which
    the shapes cut these planes.

    Parameters
    ----------
    frame, kinds, locals_ : as in `parallel_silhouettes`

    Returns
    -------
    silhouettes and curves, and bounds
    """
    whole = parallel_silhouettes(frame, kinds, locals_)
    center, axes = half_axes(locals_)
    along = frame[0] / (frame[0] @ frame[0])  # 0 and 1 on the planes
    middle, reach = (center - frame[1]) @ along, np.einsum("k,ski->si", along, axes)
    kept = _between(whole, kinds, middle, reach, locals_ @ np.append(frame[0], 0.0))
    forms, shapes = [whole.forms[kept]], [whole.shapes[kept]]
    for end in (0.0, 1.0):
        w = frame[1:].T.copy()
        w[:, 0] += end * frame[0]
        place = locals_[:, :, :3] @ w
        place[:, :, 0] += locals_[:, :, 3]
        for kind in (BALL, CYLINDER, CONE, BOX, HALFSPACE):
            rows = np.flatnonzero(kinds == kind)
            found = _section_forms(kind, place[rows])
            size = np.abs(found).max(axis=(2, 3))
            met = size > 0
            if kind == CYLINDER:  # its ends, where they may meet the plane
                low, high = _ends(middle[rows], reach[rows])
                met[:, 1] &= ((low <= end) & (end <= high)).any(axis=1)
            s, f = np.nonzero(met)
            forms.append(_coefficients(found[s, f] / size[s, f, None, None]))
            shapes.append(rows[s])
    order = np.argsort(np.concatenate(shapes), kind="stable")
    roots = np.append(whole.roots[kept], np.zeros(len(order) - np.count_nonzero(kept)))
    return Silhouettes(np.concatenate(forms)[order], np.concatenate(shapes)[order], roots[order], whole.bounds)


def _between(
    outline: Silhouettes,
    kinds: Int64[np.ndarray, " shape"],
    middle: Float[np.ndarray, " shape"],
    reach: Float[np.ndarray, "shape 3"],
    direction: Float[np.ndarray, "shape 3"],
) -> Bool[np.ndarray, " form"]:
    """Which silhouettes may lie between heights 0 and 1: all but those of balls and of the ends of cylinders elsewhere.

    `middle` and `reach` are the heights of centres and half axes, `direction` that of the rays in local coordinates.
    """
    kept, owner = np.ones(len(outline.shapes), np.bool_), outline.shapes
    # A ball is touched in the plane through its centre that the local direction of rays is normal to.
    length = np.linalg.norm(direction, axis=1, keepdims=True)
    unit = np.divide(direction, length, out=np.zeros_like(direction), where=length > 0)
    across = np.linalg.norm(reach - (reach * unit).sum(axis=1, keepdims=True) * unit, axis=1)
    outside = (middle - across > 1) | (middle + across < 0)
    kept[(kinds == BALL)[owner] & outside[owner]] = False
    low, high = _ends(middle, reach)
    missed = (low > 1) | (high < 0)
    rims = (kinds == CYLINDER)[owner] & (outline.roots == 0)  # two of each cylinder, in this order
    second = rims & np.append(False, rims[:-1] & (owner[1:] == owner[:-1]))
    paired = rims & (second | np.append(second[1:], False))
    kept[paired & np.where(second, missed[owner, 1], missed[owner, 0])] = False
    return kept


def _ends(
    middle: Float[np.ndarray, " shape"], reach: Float[np.ndarray, "shape 3"]
) -> tuple[Float[np.ndarray, "shape 2"], Float[np.ndarray, "shape 2"]]:
    """Lowest and highest point of both ends of cylinders, from the heights of their centres and half axes."""
    ends = middle[:, None] + reach[:, 2:] * np.array([-1.0, 1.0])
    disc = np.hypot(reach[:, 0], reach[:, 1])[:, None]
    return ends - disc, ends + disc


def _section_forms(kind: int, place: Float[np.ndarray, "shape 3 3"]) -> Float[np.ndarray, "shape form 3 3"]:
    """Forms that vanish where points are on the surface of a primitive; points come as rows over (1, u, v)."""
    one = np.zeros((3, 3))
    one[0, 0] = 1.0
    x, y, z = (place[:, i, :, None] * place[:, i, None, :] for i in range(3))
    if kind == BALL:
        return (x + y + z - one)[:, None]
    if kind == CYLINDER:
        return np.stack([x + y - one, z - one], axis=1)
    if kind == CONE:
        return np.stack([x + y - z, z - one], axis=1)
    if kind == BOX:
        return np.stack([x - one, y - one, z - one], axis=1)
    linear = np.zeros((len(place), 3, 3))
    linear[:, 0] += place[:, 2] / 2
    linear[:, :, 0] += place[:, 2] / 2
    return linear[:, None]


def _coefficients(q: Float[np.ndarray, "form 3 3"]) -> Float[np.ndarray, "form 6"]:
    """Coefficients of 1, u, v, u^2, u v and v^2."""
    return np.stack([q[:, 0, 0], 2 * q[:, 0, 1], 2 * q[:, 0, 2], q[:, 1, 1], 2 * q[:, 1, 2], q[:, 2, 2]], 1)


def no_silhouettes(bounds: Float[np.ndarray, "shape 4"]) -> Silhouettes:
    """Create silhouettes without forms.

    Parameters
    ----------
    bounds : as in `Silhouettes`

    Returns
    -------
    the bounds alone
    """
    return Silhouettes(np.empty((0, 6)), np.empty(0, np.int64), np.empty(0), bounds)


def _silhouettes(
    origin: Float[np.ndarray, "3 3"],
    direction: Float[np.ndarray, "3 3"],
    kinds: Int64[np.ndarray, " shape"],
    locals_: Float[np.ndarray, "shape 3 4"],
    bounds: Float[np.ndarray, "shape 4"],
) -> Silhouettes:
    d, o = locals_[:, :, :3] @ direction, locals_[:, :, :3] @ origin
    o[:, :, 0] += locals_[:, :, 3]
    moment = np.cross(o[:, :, :1], d, axis=1)
    moment[:, :, 1:] += np.cross(o[:, :, 1:], d[:, :, :1], axis=1)
    forms, shapes, roots = [np.empty((0, 6))], [np.empty(0, np.int64)], [np.empty(0)]
    for kind in (BALL, CYLINDER, CONE, BOX):
        rows = np.flatnonzero(kinds == kind)
        found, root = _primitive_forms(kind, d[rows], moment[rows])
        size = np.abs(found).max(axis=(2, 3))
        largest = np.maximum(np.abs(d[rows]).max(axis=(1, 2)), np.abs(moment[rows]).max(axis=(1, 2)))
        s, f = np.nonzero(size > _ZERO_FORM * largest[:, None] ** 2)
        q = found[s, f] / size[s, f, None, None]
        forms.append(_coefficients(q))
        shapes.append(rows[s])
        roots.append(root[f].astype(np.float64))
    order = np.argsort(np.concatenate(shapes), kind="stable")
    return Silhouettes(
        np.concatenate(forms)[order], np.concatenate(shapes)[order], np.concatenate(roots)[order], bounds
    )


def _primitive_forms(
    kind: int, d: Float[np.ndarray, "shape 3 3"], m: Float[np.ndarray, "shape 3 3"]
) -> tuple[Float[np.ndarray, "shape form 3 3"], Bool[np.ndarray, " form"]]:
    """Forms of primitives of a kind, and whether each is a tangent.

    Direction and moment come as rows over (1, u, v).
    """

    def square(row: np.ndarray) -> np.ndarray:
        return row[:, :, None] * row[:, None, :]

    if kind == BALL:
        return (d.swapaxes(1, 2) @ d - m.swapaxes(1, 2) @ m)[:, None], np.array([True])
    d0, d1, d2 = d[:, 0], d[:, 1], d[:, 2]
    m0, m1, m2 = m[:, 0], m[:, 1], m[:, 2]
    if kind == CYLINDER:
        mantle = square(d0) + square(d1) - square(m2)
        rims = [square(d2) - square(h * d0 - m1) - square(h * d1 + m0) for h in (-1.0, 1.0)]
        return np.stack([mantle, *rims], axis=1), np.array([True, False, False])
    if kind == CONE:
        mantle = square(m0) + square(m1) - square(m2)
        rim = square(d2) - square(d0 - m1) - square(d1 + m0)
        return np.stack([mantle, rim], axis=1), np.array([True, False])
    cyclic = [(1, 2, 0), (2, 0, 1), (0, 1, 2)]
    edges = [square(m[:, k]) - square(d[:, i] + sign * d[:, j]) for i, j, k in cyclic for sign in (-1.0, 1.0)]
    return np.stack(edges, axis=1), np.zeros(6, np.bool_)


def cone_bounds(
    frame: Float[np.ndarray, "4 3"], kinds: Int64[np.ndarray, " shape"], locals_: Float[np.ndarray, "shape 3 4"]
) -> Float[np.ndarray, "shape 4"]:
    """Compute the rectangle on the panel around each shadow; that of the enclosing cube but for round primitives.

    Parameters
    ----------
    frame, kinds, locals_ : as in `cone_silhouettes`

    Returns
    -------
    lowest u, highest u, lowest v, highest v [pixel]; infinite for one that reaches behind the source
    """
    center, axes = _projected(np.linalg.inv(frame[1:].T), frame[0], locals_)
    along = axes[:, 0]
    reach = np.where(kinds == BALL, np.sqrt((along**2).sum(axis=1)), np.abs(along).sum(axis=1))
    before = (center[:, 0] - reach > 1e-9) & (kinds != HALFSPACE)
    bounds = np.tile([-np.inf, np.inf, -np.inf, np.inf], (len(locals_), 1))
    for kind in np.unique(kinds[before]):
        rows = np.flatnonzero(before & (kinds == kind))
        c, a = center[rows], axes[rows]
        if kind == BALL:
            parts = [_ellipsoid_bounds(c, a)]
        elif kind == CYLINDER:
            parts = [_ellipsoid_bounds(c + side * a[:, :, 2], a[:, :, :2]) for side in (-1.0, 1.0)]
        elif kind == CONE:
            parts = [_ellipsoid_bounds(c, a[:, :, :0]), _ellipsoid_bounds(c + a[:, :, 2], a[:, :, :2])]
        else:
            corners = np.array(np.meshgrid(*[(-1.0, 1.0)] * 3)).reshape(3, 8)
            points = (c + np.moveaxis(a @ corners, 2, 0)).reshape(-1, 3)
            parts = _ellipsoid_bounds(points, np.empty((len(points), 3, 0))).reshape(8, -1, 4)
        lowest, highest = np.min(parts, axis=0), np.max(parts, axis=0)
        bounds[rows] = np.where([True, False, True, False], lowest, highest)
    return bounds


def _ellipsoid_bounds(
    center: Float[np.ndarray, "shape 3"], axes: Float[np.ndarray, "shape 3 axis"]
) -> Float[np.ndarray, "shape 4"]:
    """Rectangle around the shadows of ellipsoids, flat with two half axes, points with none.

    A plane ``u = constant`` touches one with homogeneous centre c (depth, u, v) and half axes b where
    ``(c_u - u c_d)^2 = |b_u - u b_d|^2``; the roots are taken relative to the projected centre, where nothing cancels.
    """
    depth, along = center[:, 0], axes[:, 0]
    a, bounds = depth**2 - (along**2).sum(axis=1), []
    for across in (1, 2):
        middle = center[:, across] / depth
        side = axes[:, across] - middle[:, None] * along
        half = (side * along).sum(axis=1)
        root = np.sqrt(half**2 + (side**2).sum(axis=1) * a)
        bounds += [middle + (-half - root) / a, middle + (-half + root) / a]
    return np.stack(bounds, axis=1)


def parallel_bounds(
    frame: Float[np.ndarray, "4 3"],
    kinds: Int64[np.ndarray, " shape"],
    locals_: Float[np.ndarray, "shape 3 4"],
    tubes: Float[np.ndarray, " shape"] | None = None,
) -> Float[np.ndarray, "shape 4"]:
    """Compute the rectangles around the shadows for parallel rays.

    Parameters
    ----------
    frame, kinds, locals_ : as in `parallel_silhouettes`
    tubes : radius of the tube of a torus in local coordinates; None for rectangles around whole cubes

    Returns
    -------
    lowest u, highest u, lowest v, highest v of each shape
    """
    center, axes = _projected(np.linalg.inv(frame[[0, 2, 3]].T), frame[1], locals_)
    x, y, z = np.abs(np.moveaxis(axes[:, 1:], 2, 0))
    ball, round_ = (kinds == BALL)[:, None], np.isin(kinds, (CYLINDER, CONE))[:, None]
    if tubes is not None:
        z, round_ = np.where((kinds == TORUS)[:, None], z * tubes[:, None], z), round_ | (kinds == TORUS)[:, None]
    reach = np.where(ball, np.sqrt(x**2 + y**2 + z**2), np.where(round_, np.hypot(x, y) + z, x + y + z))
    reach[kinds == HALFSPACE] = np.inf
    return np.stack([center[:, 1:] - reach, center[:, 1:] + reach], axis=2).reshape(-1, 4)


def _projected(
    matrix: Float[np.ndarray, "3 3"], origin: Float[np.ndarray, " 3"], locals_: Float[np.ndarray, "shape 3 4"]
) -> tuple[Float[np.ndarray, "shape 3"], Float[np.ndarray, "shape 3 3"]]:
    """Project the centres and half axes of the cubes that enclose primitives to depth, u and v (homogeneous)."""
    center, axes = half_axes(locals_)
    return (center - origin) @ matrix.T, matrix @ axes
