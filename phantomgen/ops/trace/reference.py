"""Path lengths of one ray by sorting all surface crossings; as short as the definition."""

from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int64

from phantomgen.ops.primitives import BALL, CYLINDER


def crossings(kind: int, o: Float[np.ndarray, " 3"], d: Float[np.ndarray, " 3"]) -> list[float]:
    """All t where the local ray ``o + t d`` meets a surface (or the plane of a face) of a unit primitive."""
    quadric = {BALL: [0, 1, 2], CYLINDER: [0, 1]}.get(kind, [])
    flat = [i for i in range(3) if i not in quadric and d[i] != 0]
    found = [(side - o[i]) / d[i] for i in flat for side in (-1.0, 1.0)]
    if quadric:
        o, d = o[quadric], d[quadric]
        roots = np.roots([d @ d, 2 * o @ d, o @ o - 1]) if d.any() else np.empty(0)
        found += [float(t.real) for t in roots if t.imag == 0]
    return found


def inside(kind: int, x: Float[np.ndarray, " 3"]) -> bool:
    """Whether a local point lies in a unit primitive."""
    if kind == BALL:
        return bool(x @ x < 1)
    if kind == CYLINDER:
        return bool(x[:2] @ x[:2] < 1 and -1 <= x[2] < 1)
    return bool(((x >= -1) & (x < 1)).all())


def trace_one(
    origin: Float[np.ndarray, " 3"],
    direction: Float[np.ndarray, " 3"],
    kinds: Int64[np.ndarray, " shape"],
    locals_: Float[np.ndarray, "shape 3 4"],
    materials: Int64[np.ndarray, " shape"],
    count: int,
    background: int = -1,
) -> Float[np.ndarray, " material"]:
    """Path length per material [mm] of one ray ``origin + t direction``, 0 <= t <= 1.

    Between two neighbouring crossings the ray belongs to the last shape that contains the middle of that piece.
    """
    local = [(m[:, :3] @ origin + m[:, 3], m[:, :3] @ direction) for m in locals_]
    events = [t for kind, (o, d) in zip(kinds, local, strict=True) for t in crossings(kind, o, d)]
    cuts = np.unique(np.clip([0.0, 1.0, *events], 0.0, 1.0))
    lengths = np.zeros(count)
    for low, high in pairwise(cuts):
        t = (low + high) / 2
        owners = [m for kind, (o, d), m in zip(kinds, local, materials, strict=True) if inside(kind, o + t * d)]
        owner = owners[-1] if owners else background
        if owner >= 0:
            lengths[owner] += (high - low) * np.linalg.norm(direction)
    return lengths
