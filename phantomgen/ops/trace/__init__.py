"""Exact path lengths of rays through overlapping shapes.

A later shape overrides an earlier one where they overlap: a ray is cut where it enters or leaves a shape, and each
piece belongs to the last shape that covers it. Source or panel may lie inside a shape: a ray ends with them.
"""

import numpy as np
from jaxtyping import Float, Int64

from spectra.errors import InputError


def trace(
    origins: Float[np.ndarray, "ray 3"],
    directions: Float[np.ndarray, "ray 3"],
    kinds: Int64[np.ndarray, " shape"],
    locals_: Float[np.ndarray, "shape 3 4"],
    materials: Int64[np.ndarray, " shape"],
    count: int,
    background: int = -1,
) -> Float[np.ndarray, "ray material"]:
    """Path length per material of each ray ``origin + t direction``, 0 <= t <= 1 [mm].

    Parameters
    ----------
    origins, directions : start of each ray, and the vector from there to its end [mm]
    kinds : code of `phantomgen.ops.primitives` per shape
    locals_ : map from world [mm] to local coordinates per shape
    materials : index of the material per shape; a later shape overrides an earlier one
    count : number of materials
    background : material outside all shapes, -1 for none
    """
    from phantomgen.ops.trace import cpu  # noqa: PLC0415 - numba is only worth its import when rays are traced

    kinds, locals_, materials = checked_solids(kinds, locals_, materials, count, background)
    origins, directions = (np.ascontiguousarray(a, dtype=np.float64) for a in (origins, directions))
    out = np.empty((len(directions), count))
    table = cpu.solid_table(kinds, locals_, materials)
    active, events = np.arange(len(kinds)), cpu.event_room(len(kinds))
    cpu.trace_rays(table, locals_, background, origins, directions, active, events, out)
    return out


def checked_solids(
    kinds: np.ndarray, locals_: np.ndarray, materials: np.ndarray, count: int, background: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Arrays of shapes as kernels want them; refuses what would make a kernel write outside its arrays."""
    kinds, materials = (np.ascontiguousarray(a, dtype=np.int64) for a in (kinds, materials))
    locals_ = np.ascontiguousarray(locals_, dtype=np.float64)
    if locals_.shape != (len(kinds), 3, 4) or materials.shape != kinds.shape:
        raise InputError(
            f"{len(kinds)} shapes need maps (shape, 3, 4) and one material each, "
            f"got {locals_.shape} and {materials.shape}"
        )
    if materials.size and (materials.min() < 0 or materials.max() >= count):
        raise InputError(f"material indices must lie in 0..{count - 1}, got {materials.min()}..{materials.max()}")
    if not -1 <= background < count:
        raise InputError(f"background must be -1 or a material index below {count}, got {background}")
    return kinds, locals_, materials
