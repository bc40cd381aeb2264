"""Voxel projector for one slice of voxels and one row of pixels: fan beams, and slices of parallel beams.

Each ray meets every line of voxels once. Where it meets them is computed for all lines of a ray at once, in vectors;
then a few neighbouring voxels of each line are summed. Lines lie along the axis that the ray crosses slowest, so that
these voxels are neighbours in memory: volumes are kept both ways. Weights are those of `phantomgen.ops.project.cpu`.
"""

from collections.abc import Sequence
from math import floor
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float, Float32, Int32
from numba import njit

from phantomgen.ops.kernel_decorators import inlined
from phantomgen.ops.project.cpu import _aim, _width
from phantomgen.ops.simd import load_as, splat_as, store

# Empty voxels behind the last of a line, where a beam that ends there is taken to cover none.
PADDING = 2


class SliceScratch(NamedTuple):
    """Scratch memory for one ray.

    Parameters
    ----------
    ray : as in `phantomgen.ops.project.cpu.BeamScratch`
    places : where in memory the first voxel lies that the beam covers, of each line
    shares : weights of this voxel and the next one; weight of a voxel that is covered whole; and how many voxels the
        beam covers behind these two
    """

    ray: Float[np.ndarray, " 7"]
    places: Int32[np.ndarray, " line"]
    shares: Float32[np.ndarray, "4 line"]

    @classmethod
    def of(cls, shape: Sequence[int]) -> "SliceScratch":
        """Allocate the memory.

        Parameters
        ----------
        shape : number of voxels along (z, y, x)

        Returns
        -------
        arrays without values
        """
        most = max(shape[1:])
        return cls(np.empty(7), np.empty(most, dtype=np.int32), np.empty((4, most), dtype=np.float32))


@inlined
@no_type_check
def _meet(view, column, together, scratch):
    """Write which voxels of each line the ray of a column covers, and their weights, but for the ray's length.

    Returns
    -------
    the axis that the ray crosses fastest, the number of lines that it meets, and whether it may cover more than two
    voxels of a line
    """
    frame, parallel, spacing, strides = view
    ray, places, shares = scratch
    counts = strides[0]
    axis = _aim(frame, parallel, spacing, float(column), 0.0, ray)
    across = 3 - axis
    wide, tall = _width(frame, ray, axis, across), _width(frame, ray, axis, 0)
    begin, thick, end = ray[axis], 1.0 / ray[3 + axis], float(counts[across])
    first = int(max(0.0, min(floor(min(begin, begin + ray[3 + axis]) + 0.5), float(counts[axis]))))
    last = int(max(-1.0, min(counts[axis] - 1.0, floor(max(begin, begin + ray[3 + axis]) + 0.5))))
    count = max(last + 1 - first, 0)
    line = (counts[across] + PADDING) * together
    start, slope, height, rise = ray[across] + 0.5, ray[3 + across], ray[0] + 0.5, ray[3]
    wholes, seconds, units, rests = shares[0], shares[1], shares[2], shares[3]
    for k in range(count):  # counted from 0, so that the compiler makes vectors of it
        at = np.int32(k + first)
        one, other = (at - 0.5 - begin) * thick, (at + 0.5 - begin) * thick
        near, far = max(0.0, min(one, other)), min(1.0, max(one, other))
        t = 0.5 * (near + far)
        size = 1.0 if parallel else t
        depth, width = max(size * tall, 1.0), max(size * wide, 1.0)
        bottom, left = height + t * rise - 0.5 * depth, start + t * slope - 0.5 * width
        covered = max(min(bottom + depth, 1.0) - max(bottom, 0.0), 0.0)
        unit = max(far - near, 0.0) * covered / (depth * width)
        low, high = min(max(left, 0.0), end), min(max(left + width, 0.0), end)
        i = np.int32(low)
        begun = min(i + 1.0 - low, high - low)
        second = min(high - low - begun, 1.0)
        places[k] = at * np.int32(line) + i * np.int32(together)
        wholes[k], seconds[k] = unit * begun, unit * second
        units[k], rests[k] = unit, high - low - begun - second
    return axis, count, wide > 1.0


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def forward(lanes, along_x, along_y, view, scratch, out):
    """Write the line integrals of one view.

    Parameters
    ----------
    lanes : a tuple, as long as there are components, which lie side by side in memory; its values are not used
    along_x, along_y : the volume as lines along x and as lines along y, each with `PADDING`, flat
    view : `phantomgen.ops.project.cpu.VoxelView`
    scratch : `SliceScratch`
    out : line integrals (column and component), written
    """
    together, places, shares = len(lanes), scratch.places, scratch.shares
    for column in range(out.size // together):
        axis, count, is_wide = _meet(view, column, together, scratch)
        lines = along_x if axis == 1 else along_y
        total = further = splat_as(lanes, np.float32(0.0))
        for k in range(count):
            at = places[k]
            total = total + load_as(lanes, lines, at) * shares[0, k]
            further = further + load_as(lanes, lines, at + together) * shares[1, k]
            if is_wide:
                rest = shares[3, k]
                at += 2 * together
                while rest > 0.0:
                    total = total + load_as(lanes, lines, at) * (shares[2, k] * min(rest, np.float32(1.0)))
                    rest -= np.float32(1.0)
                    at += together
        store(out, column * together, (total + further) * np.float32(scratch.ray[6]))


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def backward(lanes, image, view, scratch, along_x, along_y):
    """Add the pixels of one view, times their weights, to volumes.

    Parameters
    ----------
    lanes : as in `forward`
    image : pixels (column and component)
    view, scratch : as in `forward`
    along_x, along_y : volumes of which the sum is meant, laid out as in `forward`, added to
    """
    together, places, shares = len(lanes), scratch.places, scratch.shares
    for column in range(image.size // together):
        axis, count, is_wide = _meet(view, column, together, scratch)
        lines = along_x if axis == 1 else along_y
        value = load_as(lanes, image, column * together) * np.float32(scratch.ray[6])
        for k in range(count):
            at = places[k]
            store(lines, at, load_as(lanes, lines, at) + value * shares[0, k])
            at += together
            store(lines, at, load_as(lanes, lines, at) + value * shares[1, k])
            if is_wide:
                rest = shares[3, k]
                at += together
                while rest > 0.0:
                    weight = shares[2, k] * min(rest, np.float32(1.0))
                    store(lines, at, load_as(lanes, lines, at) + value * weight)
                    rest -= np.float32(1.0)
                    at += together
