"""Gradient of the voxel projector in the poses, in numba: how a sum of pixels follows the four vectors of a view.

A ray's sum depends on where its beam crosses each layer, on how wide it is there, and on its lengths; within a voxel
all of these are smooth. What a beam gains when its edge moves is the value of the voxels at this edge. Where a ray
changes its main axis the projector itself jumps a little; the gradient leaves this out.
"""

from collections.abc import Sequence
from math import floor
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float
from numba import njit

from phantomgen.ops.kernel_decorators import inlined
from phantomgen.ops.project.cpu import _aim, _range, _spread, _width


class PoseScratch(NamedTuple):
    """Scratch memory of one view.

    Parameters
    ----------
    ray : origin, direction [voxel], and length [mm]
    slopes : derivatives in origin and direction
    weights : of the voxels across, along either axis
    """

    ray: Float[np.ndarray, " 7"]
    slopes: Float[np.ndarray, "2 3"]
    weights: Float[np.ndarray, "2 voxel"]

    @classmethod
    def of(cls, shape: Sequence[int]) -> "PoseScratch":
        """Allocate the memory.

        Parameters
        ----------
        shape : number of voxels along each axis

        Returns
        -------
        arrays without values
        """
        return cls(np.empty(7), np.empty((2, 3)), np.empty((2, max(shape))))


@inlined
@no_type_check
def _voxel(volume, cotangents, place, inside):
    """Sum of the components of a voxel, each times its cotangent; 0 outside of the grid."""
    total = 0.0
    if inside:
        for c in range(cotangents.size):
            total += cotangents[c] * volume[place, c]
    return total


@inlined
@no_type_check
def _narrow(volume, cotangents, layer, middles, axes):
    """Value of a beam that is a voxel wide in both directions, and the values at its edges; see `_broad`."""
    (middle_a, middle_b), (count_a, count_b, step_a, step_b) = middles, axes
    if not (-1.0 < middle_a < count_a and -1.0 < middle_b < count_b):
        return 0.0, 0.0, 0.0, 0.0, 0.0
    i, j = int(floor(middle_a)), int(floor(middle_b))
    past_a, past_b = middle_a - i, middle_b - j
    in_a, in_b, beyond_a, beyond_b = i >= 0, j >= 0, i + 1 < count_a, j + 1 < count_b
    place = layer + i * step_a + j * step_b
    v00 = _voxel(volume, cotangents, place, in_a and in_b)
    v01 = _voxel(volume, cotangents, place + step_b, in_a and beyond_b)
    v10 = _voxel(volume, cotangents, place + step_a, beyond_a and in_b)
    v11 = _voxel(volume, cotangents, place + step_a + step_b, beyond_a and beyond_b)
    low_a, high_a = v00 + past_b * (v01 - v00), v10 + past_b * (v11 - v10)
    low_b, high_b = v00 + past_a * (v10 - v00), v01 + past_a * (v11 - v01)
    return low_a + past_a * (high_a - low_a), low_a, high_a, low_b, high_b


@inlined
@no_type_check
def _line(volume, cotangents, begin, stride, weights, count):
    """Sum of a line of voxels, each times its weight."""
    total = 0.0
    for i in range(count):
        total += weights[i] * _voxel(volume, cotangents, begin + i * stride, True)
    return total


@inlined
@no_type_check
def _at_edge(volume, cotangents, place, ends, line):
    """Value of the voxels at the edge of a beam: 0 outside.

    `ends` are the number of voxels and their stride along the axis of the edge; `line` is where the line of voxels
    along the other axis begins, its stride, weights and number.
    """
    (count, step), (begin, stride, weights, voxels) = ends, line
    i = floor(place + 0.5)
    if i < 0.0 or i >= count:
        return 0.0
    return _line(volume, cotangents, begin + int(i) * step, stride, weights, voxels)


@inlined
@no_type_check
def _broad(volume, cotangents, layer, beam, axes, weights):
    """Value of a beam, and the values at its edges: at the lower and the higher one along a, then along b.

    `layer` is where the voxels of the layer begin, `beam` the middle and the width along a, then along b; `axes` are
    the number of voxels along a and b, and how far apart they are.
    """
    (middle_a, width_a, middle_b, width_b), (count_a, count_b, step_a, step_b) = beam, axes
    ja, na = _spread(middle_a, width_a, 0, count_a - 1, weights[0])
    jb, nb = _spread(middle_b, width_b, 0, count_b - 1, weights[1])
    along_a = (layer + ja * step_a, step_a, weights[0], na)
    along_b = (layer + jb * step_b, step_b, weights[1], nb)
    value = 0.0
    for i in range(na):
        value += weights[0, i] * _line(volume, cotangents, along_b[0] + (ja + i) * step_a, step_b, weights[1], nb)
    low_a = _at_edge(volume, cotangents, middle_a - 0.5 * width_a, (count_a, step_a), along_b)
    high_a = _at_edge(volume, cotangents, middle_a + 0.5 * width_a, (count_a, step_a), along_b)
    low_b = _at_edge(volume, cotangents, middle_b - 0.5 * width_b, (count_b, step_b), along_a)
    high_b = _at_edge(volume, cotangents, middle_b + 0.5 * width_b, (count_b, step_b), along_a)
    return value, low_a, high_a, low_b, high_b


@inlined
@no_type_check
def _add_shadow(frame, ray, axes, slope, out):
    """Add what the frame and the direction of a ray do to the width of its shadow, times `slope`."""
    axis, across, slopes = axes
    tilt = ray[3 + across] / ray[3 + axis]
    column, row = frame[2, across] - tilt * frame[2, axis], frame[3, across] - tilt * frame[3, axis]
    width = (column * column + row * row) ** 0.5
    if width == 0.0 or slope == 0.0:
        return
    column, row = slope * column / width, slope * row / width
    out[2, across] += column
    out[3, across] += row
    out[2, axis] -= tilt * column
    out[3, axis] -= tilt * row
    along = -(column * frame[2, axis] + row * frame[3, axis]) / ray[3 + axis]
    slopes[1, across] += along
    slopes[1, axis] -= tilt * along


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def pose_derivatives(volume, cotangents, view, scratch, out):
    """Add the derivatives of a weighted sum of the pixels of one view in its four vectors.

    Parameters
    ----------
    volume : values (voxel, component)
    cotangents : weights of the pixels (row, column, component)
    view : `phantomgen.ops.project.cpu.VoxelView`
    scratch : `PoseScratch`
    out : derivatives in the frame (vector, axis) [1/voxel], added to
    """
    frame, parallel, spacing, strides = view
    ray, slopes, weights = scratch
    for row in range(cotangents.shape[0]):
        for column in range(cotangents.shape[1]):
            here = cotangents[row, column]
            axis = _aim(frame, parallel, spacing, float(column), float(row), ray)
            a, b = (1 if axis == 0 else 0), (1 if axis == 2 else 2)
            wide_a, wide_b = _width(frame, ray, axis, a), _width(frame, ray, axis, b)
            axes = (strides[0, a], strides[0, b], strides[1, a], strides[1, b])
            first, last = _range(ray, axis, strides[0, axis] - 1, 0, strides[0, 0] - 1, 0.5 * max(wide_a, 1.0) + 1.0)
            thick, sign = 1.0 / ray[3 + axis], (1.0 if ray[3 + axis] > 0 else -1.0)
            slopes[:] = 0.0
            total = by_wide_a = by_wide_b = 0.0
            for k in range(first, last + 1):
                near, far = (k - 0.5 * sign - ray[axis]) * thick, (k + 0.5 * sign - ray[axis]) * thick
                t0, t1 = max(0.0, near), min(1.0, far)
                if t1 <= t0:
                    continue
                t, depth = 0.5 * (t0 + t1), t1 - t0
                size = 1.0 if parallel else t
                middle_a, middle_b = ray[a] + t * ray[3 + a], ray[b] + t * ray[3 + b]
                width_a, width_b = max(1.0, size * wide_a), max(1.0, size * wide_b)
                layer, middles = k * strides[1, axis], (middle_a, middle_b)
                if width_a == 1.0 and width_b == 1.0:
                    value, low_a, high_a, low_b, high_b = _narrow(volume, here, layer, middles, axes)
                else:
                    beam = (middle_a, width_a, middle_b, width_b)
                    value, low_a, high_a, low_b, high_b = _broad(volume, here, layer, beam, axes, weights)
                total += depth * value
                by_a, by_b = depth * (high_a - low_a) / width_a, depth * (high_b - low_b) / width_b
                by_t = by_a * ray[3 + a] + by_b * ray[3 + b]
                if size * wide_a > 1.0:
                    slope = depth * (0.5 * (high_a + low_a) - value) / width_a
                    by_wide_a += slope * size
                    by_t += 0.0 if parallel else slope * wide_a
                if size * wide_b > 1.0:
                    slope = depth * (0.5 * (high_b + low_b) - value) / width_b
                    by_wide_b += slope * size
                    by_t += 0.0 if parallel else slope * wide_b
                slopes[0, a] += by_a
                slopes[0, b] += by_b
                slopes[1, a] += by_a * t
                slopes[1, b] += by_b * t
                by_near = 0.5 * by_t - value if near > 0.0 else 0.0
                by_far = 0.5 * by_t + value if far < 1.0 else 0.0
                slopes[0, axis] -= (by_near + by_far) * thick
                slopes[1, axis] -= (by_near * near + by_far * far) * thick
            for i in range(3):
                slopes[0, i] *= ray[6]
                slopes[1, i] = slopes[1, i] * ray[6] + total * ray[3 + i] * spacing[i] * spacing[i] / ray[6]
            _add_shadow(frame, ray, (axis, a, slopes), by_wide_a * ray[6], out)
            _add_shadow(frame, ray, (axis, b, slopes), by_wide_b * ray[6], out)
            fixed, moving = (1, 0) if parallel else (0, 1)
            for i in range(3):
                out[0, i] += slopes[fixed, i]
                out[1, i] += slopes[moving, i]
                out[2, i] += column * slopes[moving, i]
                out[3, i] += row * slopes[moving, i]
