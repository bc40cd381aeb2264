"""Path lengths of one ray by sorting all surface crossings; as short as the definition."""

from itertools import pairwise

import numpy as np
from jaxtyping import Float

from phantomgen.ops.primitives import BALL, BOX, CONE, CYLINDER, HALFSPACE, TORUS
from phantomgen.ops.solids import Solids

_QUADRICS = {BALL: (1, 1, 1, -1), CYLINDER: (1, 1, 0, -1), CONE: (1, 1, -1, 0)}  # x^2, y^2, z^2, 1
_PLANES = {CYLINDER: [(2, -1), (2, 1)], CONE: [(2, 0), (2, 1)], HALFSPACE: [(2, 0)]}
_PLANES[BOX] = [(axis, side) for axis in range(3) for side in (-1, 1)]


def crossings(kind: int, tube: float, o: Float[np.ndarray, " 3"], d: Float[np.ndarray, " 3"]) -> list[float]:
    """Compute all t where a local ray meets a surface, or the plane of a face, of a unit primitive.

    Parameters
    ----------
    kind : code of `phantomgen.ops.primitives`
    tube : radius of the tube of a torus
    o, d : of the ray ``o + t d``, in local coordinates

    Returns
    -------
    values of t, in no order
    """
    found = [(side - o[axis]) / d[axis] for axis, side in _PLANES.get(kind, []) if d[axis] != 0]
    polynomial = np.zeros(1)
    if kind in _QUADRICS:
        *squares, constant = _QUADRICS[kind]
        polynomial = np.array([d * d @ squares, 2 * o * d @ squares, o * o @ squares + constant])
    if kind == TORUS:
        distance = np.array([d @ d, 2 * o @ d, o @ o + (1 - tube) ** 2 - tube**2])
        radial = np.array([d[:2] @ d[:2], 2 * o[:2] @ d[:2], o[:2] @ o[:2]])
        polynomial = np.polysub(np.polymul(distance, distance), 4 * (1 - tube) ** 2 * radial)
    return found + [float(t.real) for t in np.roots(polynomial) if abs(t.imag) < 1e-9]


def inside(kind: int, tube: float, point: Float[np.ndarray, " 3"]) -> bool | np.bool_:
    """Return whether a local point lies in a unit primitive.

    Parameters
    ----------
    kind : code of `phantomgen.ops.primitives`
    tube : radius of the tube of a torus
    point : (x, y, z) in local coordinates

    Returns
    -------
    True where it lies inside
    """
    x, y, z = point
    if kind == BALL:
        return x * x + y * y + z * z < 1
    if kind == CYLINDER:
        return x * x + y * y < 1 and -1 <= z < 1
    if kind == CONE:
        return x * x + y * y < z * z and 0 <= z < 1
    if kind == HALFSPACE:
        return z < 0
    if kind == TORUS:
        return (np.hypot(x, y) - 1 + tube) ** 2 + z * z < tube**2
    return all(-1 <= c < 1 for c in point)


def owner_at(solids: Solids, point: Float[np.ndarray, " 3"], background: int = -1) -> int:
    """Return the material at a point, which is that of the last object with a term that contains it.

    Parameters
    ----------
    solids : the objects
    point : (x, y, z) [mm]
    background : material outside all shapes, -1 for none

    Returns
    -------
    index of the material
    """
    holds = [
        inside(int(kind), tube, m[:, :3] @ point + m[:, 3]) == wanted
        for kind, tube, m, wanted in zip(solids.kinds, solids.tubes, solids.locals_, solids.inside, strict=True)
    ]
    for term in np.unique(solids.terms)[::-1]:
        rows = np.flatnonzero(solids.terms == term)
        if all(holds[row] for row in rows):
            return int(solids.materials[rows[0]])
    return background


def trace_one(
    origin: Float[np.ndarray, " 3"],
    direction: Float[np.ndarray, " 3"],
    solids: Solids,
    count: int,
    background: int = -1,
) -> Float[np.ndarray, " material"]:
    """Compute the path length per material of one ray ``origin + t direction``, 0 <= t <= 1.

    Between two neighbouring crossings the ray belongs to the object that owns the middle of that piece.

    Parameters
    ----------
    origin, direction : start of the ray, and the vector from there to its end [mm]
    solids : the objects
    count : number of materials
    background : material outside all shapes, -1 for none

    Returns
    -------
    path lengths [mm], (material,)
    """
    events = [
        t
        for kind, tube, m in zip(solids.kinds.tolist(), solids.tubes, solids.locals_, strict=True)
        for t in crossings(kind, tube, m[:, :3] @ origin + m[:, 3], m[:, :3] @ direction)
    ]
    cuts = np.unique(np.clip([0.0, 1.0, *events], 0.0, 1.0))
    lengths = np.zeros(count)
    for low, high in pairwise(cuts):
        owner = owner_at(solids, origin + (low + high) / 2 * direction, background)
        if owner >= 0:
            lengths[owner] += (high - low) * np.linalg.norm(direction)
    return lengths
