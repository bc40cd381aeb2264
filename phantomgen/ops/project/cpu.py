"""Voxel projector and its transpose in numba; both take their weights from the same function.

All in voxel indices (z, y, x). A ray advances along the axis that it crosses fastest, one layer of voxels at a time. In
the middle of a layer its beam is a rectangle, and a voxel's weight is the part of it that lies in the voxel, times the
length of the ray in the layer. The rectangle is the pixel's shadow on the layer, but at least one voxel wide: then it
is Joseph's linear interpolation (doi:10.1109/TMI.1982.4307572), and with wide pixels the distance-driven method
(De Man & Basu 2004, doi:10.1088/0031-9155/49/11/024). Kernels get pieces of work with an output of their own: forward
a view, backward some layers of z.
"""

from collections.abc import Sequence
from math import floor, sqrt
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float, Int64
from numba import njit

from phantomgen.ops.kernel_decorators import inlined


class VoxelView(NamedTuple):
    """One view of a grid, in voxel indices and in the order (z, y, x).

    Parameters
    ----------
    frame : four vectors of the rays, as in `phantomgen.ops.project.project` [voxel]
    parallel : whether rays are parallel
    spacing : size of a voxel [mm]
    strides : number of voxels along each axis, and how far apart they are in memory
    """

    frame: Float[np.ndarray, "4 3"]
    parallel: bool
    spacing: Float[np.ndarray, " 3"]
    strides: Int64[np.ndarray, "2 3"]


class BeamScratch(NamedTuple):
    """Scratch memory for one beam.

    Parameters
    ----------
    ray : origin, direction [voxel], and length [mm]
    weights : of the voxels across, along either axis
    sums : one for each component
    """

    ray: Float[np.ndarray, " 7"]
    weights: Float[np.ndarray, "2 voxel"]
    sums: Float[np.ndarray, " component"]

    @classmethod
    def of(cls, shape: Sequence[int], components: int) -> "BeamScratch":
        """Allocate the memory.

        Parameters
        ----------
        shape : number of voxels along each axis
        components : number of components

        Returns
        -------
        arrays without values
        """
        return cls(np.empty(7), np.empty((2, max(shape))), np.empty(components))


@inlined
@no_type_check
def _aim(frame, parallel, spacing, u, v, ray):
    """Write origin, direction (voxels), length of the direction [mm]; return the axis that the ray crosses fastest."""
    squares, fastest, axis = 0.0, -1.0, 0
    for i in range(3):
        along = frame[1, i] + u * frame[2, i] + v * frame[3, i]
        ray[i], ray[3 + i] = (along, frame[0, i]) if parallel else (frame[0, i], along)
        squares += (ray[3 + i] * spacing[i]) * (ray[3 + i] * spacing[i])
        if abs(ray[3 + i]) > fastest:
            fastest, axis = abs(ray[3 + i]), i
    ray[6] = sqrt(squares)
    return axis


@inlined
@no_type_check
def _width(frame, ray, axis, across):
    """Width of a pixel's shadow, at t = 1, on a layer of `axis` in the direction `across` [voxel].

    The shadow is a parallelogram; where it lies askew, this is the width of the box with its variance.
    """
    slope = ray[3 + across] / ray[3 + axis]
    column, row = frame[2, across] - slope * frame[2, axis], frame[3, across] - slope * frame[3, axis]
    return sqrt(column * column + row * row)


@inlined
@no_type_check
def _range(ray, axis, last, low, high, reach):
    """First and last layer of `axis` that the ray meets where it comes within `reach` of low <= z <= high."""
    begin, step = ray[axis], ray[3 + axis]
    first = max(0.0, floor(min(begin, begin + step) + 0.5))
    final = min(float(last), floor(max(begin, begin + step) + 0.5))
    if axis == 0:
        return int(max(first, float(low))), int(min(final, float(high)))
    near, far, rise = low - reach - ray[0], high + reach - ray[0], ray[3]
    if abs(rise) < 1e-9 * abs(step):
        inside = near - abs(rise) < 0.0 < far + abs(rise)
        return int(first), (int(final) if inside else int(first) - 1)
    one, other = begin + near / rise * step, begin + far / rise * step
    # Bounds that may be far away are clipped before they become integers.
    first = max(first, min(floor(min(one, other)), final + 1.0))
    return int(first), int(min(final, max(floor(max(one, other)) + 1.0, first - 1.0)))


@inlined
@no_type_check
def _spread(centre, width, first, last, weights):
    """Write which part of a beam lies in each voxel from `first` to `last`; return where it begins, and how many."""
    width = max(width, 1.0)
    left, right, scale = centre - 0.5 * width, centre + 0.5 * width, 1.0 / width
    low, high = max(float(first), floor(left + 0.5)), min(float(last), floor(right + 0.5))
    if high < low:
        return first, 0
    begin, count = int(low), int(high - low) + 1
    for i in range(count):
        weights[i] = max(0.0, min(right, low + i + 0.5) - max(left, low + i - 0.5)) * scale
    return begin, count


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def forward(volume, view, scratch, out):
    """Write the line integrals of one view.

    Parameters
    ----------
    volume : values (component, voxel)
    view : `VoxelView`
    scratch : `BeamScratch`
    out : line integrals (component, row, column), written
    """
    frame, parallel, spacing, strides = view
    ray, weights, sums = scratch
    low, high = 0, strides[0, 0] - 1
    for row in range(out.shape[1]):
        for column in range(out.shape[2]):
            axis = _aim(frame, parallel, spacing, float(column), float(row), ray)
            a, b = (1 if axis == 0 else 0), (1 if axis == 2 else 2)
            wide_a, wide_b = _width(frame, ray, axis, a), _width(frame, ray, axis, b)
            first, last = _range(ray, axis, strides[0, axis] - 1, low, high, 0.5 * max(wide_a, 1.0) + 1.0)
            for c in range(sums.size):
                sums[c] = 0.0
            thick = 1.0 / ray[3 + axis]
            for k in range(first, last + 1):
                t0, t1 = (k - 0.5 - ray[axis]) * thick, (k + 0.5 - ray[axis]) * thick
                t0, t1 = max(0.0, min(t0, t1)), min(1.0, max(t0, t1))
                if t1 <= t0:
                    continue
                t, size = 0.5 * (t0 + t1), (1.0 if parallel else 0.5 * (t0 + t1))
                ja, na = _spread(ray[a] + t * ray[3 + a], size * wide_a, 0, strides[0, a] - 1, weights[0])
                jb, nb = _spread(ray[b] + t * ray[3 + b], size * wide_b, 0, strides[0, b] - 1, weights[1])
                place = k * strides[1, axis] + ja * strides[1, a] + jb * strides[1, b]
                for c in range(sums.size):
                    total = 0.0
                    for i in range(na):
                        line = 0.0
                        for j in range(nb):
                            line += weights[1, j] * volume[c, place + i * strides[1, a] + j * strides[1, b]]
                        total += weights[0, i] * line
                    sums[c] += (t1 - t0) * total
            for c in range(sums.size):
                out[c, row, column] = sums[c] * ray[6]


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def backward(images, view, low, high, scratch, volume):
    """Add the pixels of one view, times their weights, to some layers of a volume.

    Parameters
    ----------
    images : pixels (component, row, column)
    view : `VoxelView`
    low, high : first and last layer of z
    scratch : `BeamScratch`
    volume : values (component, voxel) of all layers, added to
    """
    frame, parallel, spacing, strides = view
    ray, weights, sums = scratch
    for row in range(images.shape[1]):
        for column in range(images.shape[2]):
            axis = _aim(frame, parallel, spacing, float(column), float(row), ray)
            a, b = (1 if axis == 0 else 0), (1 if axis == 2 else 2)
            wide_a, wide_b = _width(frame, ray, axis, a), _width(frame, ray, axis, b)
            first, last = _range(ray, axis, strides[0, axis] - 1, low, high, 0.5 * max(wide_a, 1.0) + 1.0)
            if last < first:
                continue
            first_a, last_a = (low, high) if a == 0 else (0, strides[0, a] - 1)
            for c in range(sums.size):
                sums[c] = ray[6] * images[c, row, column]
            thick = 1.0 / ray[3 + axis]
            for k in range(first, last + 1):
                t0, t1 = (k - 0.5 - ray[axis]) * thick, (k + 0.5 - ray[axis]) * thick
                t0, t1 = max(0.0, min(t0, t1)), min(1.0, max(t0, t1))
                if t1 <= t0:
                    continue
                t, size = 0.5 * (t0 + t1), (1.0 if parallel else 0.5 * (t0 + t1))
                ja, na = _spread(ray[a] + t * ray[3 + a], size * wide_a, first_a, last_a, weights[0])
                jb, nb = _spread(ray[b] + t * ray[3 + b], size * wide_b, 0, strides[0, b] - 1, weights[1])
                place = k * strides[1, axis] + ja * strides[1, a] + jb * strides[1, b]
                for c in range(sums.size):
                    for i in range(na):
                        part = (t1 - t0) * weights[0, i] * sums[c]
                        for j in range(nb):
                            volume[c, place + i * strides[1, a] + j * strides[1, b]] += weights[1, j] * part
