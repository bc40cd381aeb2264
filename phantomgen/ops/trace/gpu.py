"""Exact path lengths in Triton: for objects that are one primitive each, in float64.

Each lane follows one ray from event to event: between two of them, the last shape that covers the ray owns it. Rays
that all but miss a surface are not looked at in twice the precision, as on the CPU, so that a chord which grazes may be
off by 1e-8 of its shape. The tests run the kernel in Triton's interpreter.
"""

from typing import no_type_check

import numpy as np
import torch
import triton
import triton.language as tl
from jaxtyping import Float
from torch import Tensor

from phantomgen.ops.primitives import BALL, BOX, CONE, CYLINDER, HALFSPACE, MESH, TORUS
from phantomgen.ops.solids import Solids
from spectra.errors import InputError

_BLOCK = 128  # rays per program
_BALL, _CYLINDER, _BOX, _CONE, _HALFSPACE = (tl.constexpr(k) for k in (BALL, CYLINDER, BOX, CONE, HALFSPACE))


def trace_on_device(
    origins: Float[Tensor, "ray 3"],
    directions: Float[Tensor, "ray 3"],
    solids: Solids,
    count: int,
    background: int = -1,
) -> Float[Tensor, "ray material"]:
    """Path length per material of each ray ``origin + t direction``, 0 <= t <= 1, on the device of the rays [mm].

    Parameters are those of `phantomgen.ops.trace.trace`.
    """
    solids = solids.checked(count, background)
    if solids.voxels is not None or np.isin(solids.kinds, (TORUS, MESH)).any():
        raise InputError("tori, meshes and voxel maps are traced on the CPU only: call `phantomgen.ops.trace.trace`")
    if (solids.owners != np.arange(solids.rows)).any() or not solids.inside.all():
        raise InputError("unions, cuts and differences are traced on the CPU only: call `phantomgen.ops.trace.trace`")
    rays = origins.to(torch.float64).contiguous(), directions.to(torch.float64).contiguous()
    maps = torch.as_tensor(solids.locals_.reshape(-1, 12), device=origins.device)
    kinds, materials = (torch.as_tensor(a, device=origins.device) for a in (solids.kinds, solids.materials))
    out = torch.zeros((len(origins), count), dtype=torch.float64, device=origins.device)
    ends = torch.empty((2, solids.rows, len(origins)), dtype=torch.float64, device=origins.device)
    if len(origins):
        blocks = (triton.cdiv(len(origins), _BLOCK),)
        _trace[blocks](*rays, maps, kinds, materials, ends, out, len(origins), solids.rows, count, background, _BLOCK)
    return out


@triton.jit
@no_type_check
def _slab(place, slope, first, last):
    """Part of ``first <= t <= last`` where ``-1 <= place + t slope < 1``."""
    flat = slope == 0.0
    low, high = (-1.0 - place) / tl.where(flat, 1.0, slope), (1.0 - place) / tl.where(flat, 1.0, slope)
    inside = (place >= -1.0) & (place < 1.0)
    first = tl.where(flat, tl.where(inside, first, 1.0), tl.maximum(first, tl.minimum(low, high)))
    return first, tl.where(flat, tl.where(inside, last, 0.0), tl.minimum(last, tl.maximum(low, high)))


@triton.jit
@no_type_check
def _round(a, b, discriminant, inside):
    """Interval where ``a t^2 + 2 b t + c < 0``; without curvature (a = 0) everything or nothing."""
    flat, root = a == 0.0, tl.sqrt(tl.maximum(discriminant, 0.0))
    safe, missed = tl.where(flat, 1.0, a), discriminant <= 0.0
    first = tl.where(missed, 1.0, tl.maximum(0.0, (-b - root) / safe))
    last = tl.where(missed, 0.0, tl.minimum(1.0, (-b + root) / safe))
    return tl.where(flat, tl.where(inside, 0.0, 1.0), first), tl.where(flat, tl.where(inside, 1.0, 0.0), last)


@triton.jit
@no_type_check
def _in_cone(x, y, z, dx, dy, dz, discriminant):
    """Interval inside the upper half of the double cone ``x^2 + y^2 < z^2``, cut off at its base."""
    a, b, c = dx * dx + dy * dy - dz * dz, x * dx + y * dy - z * dz, x * x + y * y - z * z
    begin, end = _slab(2.0 * z - 1.0, 2.0 * dz, dx * 0.0, dx * 0.0 + 1.0)
    root, safe = tl.sqrt(tl.maximum(discriminant, 0.0)), tl.where(a == 0.0, 1.0, a)
    low, high = (-b - root) / safe, (-b + root) / safe
    # Flat (a > 0) between both roots; steep (a < 0) outside them, of which one lies on the other half; else one root.
    cut, alone = -c / tl.where(b == 0.0, 1.0, 2.0 * b), a == 0.0
    first = tl.where(a > 0.0, tl.maximum(begin, low), tl.where(dz > 0.0, tl.maximum(begin, low), begin))
    last = tl.where(a > 0.0, tl.minimum(end, high), tl.where(dz > 0.0, end, tl.minimum(end, high)))
    first = tl.where(alone, tl.where(b < 0.0, tl.maximum(begin, cut), begin), first)
    last = tl.where(alone, tl.where(b > 0.0, tl.minimum(end, cut), end), last)
    missed = ((a > 0.0) & (discriminant <= 0.0)) | (alone & (b == 0.0) & (c >= 0.0))
    return tl.where(missed, 1.0, first), tl.where(missed, 0.0, last)


@triton.jit
@no_type_check
def _chord(kind, x, y, z, dx, dy, dz):
    """Interval of a ray in local coordinates inside a primitive; empty where the first end is not below the second."""
    none, whole = dx * 0.0, dx * 0.0 + 1.0
    across, mz = dx * dx + dy * dy, x * dy - y * dx
    mx, my = y * dz - z * dy, z * dx - x * dz
    turned = mx * mx + my * my
    if kind == _BALL:
        inside = x * x + y * y + z * z < 1.0
        length = across + dz * dz
        first, last = _round(length, x * dx + y * dy + z * dz, length - turned - mz * mz, inside)
    elif kind == _CYLINDER:
        first, last = _round(across, x * dx + y * dy, across - mz * mz, x * x + y * y < 1.0)
        first, last = _slab(z, dz, first, last)
    elif kind == _CONE:
        first, last = _in_cone(x, y, z, dx, dy, dz, turned - mz * mz)
    elif kind == _HALFSPACE:
        cut = -z / tl.where(dz == 0.0, 1.0, dz)
        first, last = tl.where(dz < 0.0, tl.maximum(none, cut), none), tl.where(dz > 0.0, tl.minimum(whole, cut), whole)
        last = tl.where((dz == 0.0) & (z >= 0.0), -1.0, last)
    else:
        first, last = _slab(x, dx, none, whole)
        first, last = _slab(y, dy, first, last)
        first, last = _slab(z, dz, first, last)
    return first, last


@triton.jit
@no_type_check
def _trace(
    origins, directions, maps, kinds, materials, ends, out, rays, shapes, count, background, BLOCK: tl.constexpr
):  # fmt: skip
    """Path lengths (ray, material) of a block of rays; `ends` is scratch (2, shape, ray), `out` is zero on entry."""
    ray = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    known = ray < rays
    ox, oy = tl.load(origins + 3 * ray, known, 0.0), tl.load(origins + 3 * ray + 1, known, 0.0)
    oz, dx = tl.load(origins + 3 * ray + 2, known, 0.0), tl.load(directions + 3 * ray, known, 1.0)
    dy, dz = tl.load(directions + 3 * ray + 1, known, 0.0), tl.load(directions + 3 * ray + 2, known, 0.0)
    norm, at = tl.sqrt(dx * dx + dy * dy + dz * dz), dx * 0.0 + 1.0
    for s in range(shapes):
        m = maps + 12 * s
        ax, ay, az = tl.load(m), tl.load(m + 1), tl.load(m + 2)
        bx, by, bz = tl.load(m + 4), tl.load(m + 5), tl.load(m + 6)
        cx, cy, cz = tl.load(m + 8), tl.load(m + 9), tl.load(m + 10)
        first, last = _chord(
            tl.load(kinds + s),
            ax * ox + ay * oy + az * oz + tl.load(m + 3),
            bx * ox + by * oy + bz * oz + tl.load(m + 7),
            cx * ox + cy * oy + cz * oz + tl.load(m + 11),
            ax * dx + ay * dy + az * dz,
            bx * dx + by * dy + bz * dz,
            cx * dx + cy * dy + cz * dz,
        )
        met = known & (first < last)
        tl.store(ends + s * rays + ray, tl.where(met, first, 2.0), known)
        tl.store(ends + (shapes + s) * rays + ray, tl.where(met, last, -1.0), known)
        at = tl.where(met, tl.minimum(at, first), at)
    free = norm * 1.0
    while tl.max(tl.where(known, 1.0 - at, 0.0), 0) > 0.0:
        owner, after = tl.full((BLOCK,), -1, tl.int32), at * 0.0 + 1.0
        for s in range(shapes):
            first = tl.load(ends + s * rays + ray, known, 2.0)
            last = tl.load(ends + (shapes + s) * rays + ray, known, -1.0)
            owner = tl.where((first <= at) & (at < last), s, owner)
            after = tl.minimum(after, tl.where(first > at, first, 2.0))
            after = tl.minimum(after, tl.where(last > at, last, 2.0))
        owned, part = known & (owner >= 0) & (after > at), (after - at) * norm
        place = out + ray * count + tl.load(materials + owner, owned, 0)
        tl.store(place, tl.load(place, owned, 0.0) + part, owned)
        free -= tl.where(owned, part, 0.0)
        at = after
    if background >= 0:
        place = out + ray * count + background
        tl.store(place, tl.load(place, known, 0.0) + free, known)
