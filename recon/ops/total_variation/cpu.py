"""Total variation in numba: rows of voxels along x, so that inner loops become vector instructions.

A field p has the layout (axis, basis, z, y, x): the entry of a voxel belongs to the difference to its next neighbour.
"""

from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float32
from numba import njit

from phantomgen.ops.kernel_decorators import REORDER, reordered
from spectra.ops.min_max import larger, smaller


class MixedDifferences(NamedTuple):
    """The operator W D: differences to the next voxels, mixed over the bases.

    Parameters
    ----------
    mixing : W
    scales : factors of the differences along z, y and x
    """

    mixing: Float32[np.ndarray, "basis basis"]
    scales: Float32[np.ndarray, "3"]


@reordered
@no_type_check
def _differences(volumes, scales, z, y, plain):
    """Write the differences of a row to the next voxels along z, y and x, (axis, basis, x)."""
    bases, depth, height, width = volumes.shape
    up, on = (1 if z + 1 < depth else 0), (1 if y + 1 < height else 0)
    for m in range(bases):
        for x in range(width):
            here = volumes[m, z, y, x]
            plain[0, m, x] = scales[0] * (volumes[m, z + up, y, x] - here)
            plain[1, m, x] = scales[1] * (volumes[m, z, y + on, x] - here)
        for x in range(width - 1):
            plain[2, m, x] = scales[2] * (volumes[m, z, y, x + 1] - volumes[m, z, y, x])
        plain[2, m, width - 1] = np.float32(0.0)


@reordered
@no_type_check
def _mix(mixing, plain, mixed):
    """Write W times the differences of a row."""
    _, bases, width = plain.shape
    for axis in range(3):
        for m in range(bases):
            for x in range(width):
                mixed[axis, m, x] = np.float32(0.0)
            for n in range(bases):
                factor = mixing[m, n]
                for x in range(width):
                    mixed[axis, m, x] += factor * plain[axis, n, x]


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def total_variation(volumes, operator, first, last, room, parts):
    """Compute the total variation of some slices.

    Parameters
    ----------
    volumes : (basis, z, y, x)
    operator : `MixedDifferences`
    first, last : slices from `first` to one before `last`
    room : scratch, (2, axis, basis, x)
    parts : written, sum over each slice, (z,)
    """
    mixing, scales = operator.mixing, operator.scales
    plain, mixed = room[0], room[1]
    for z in range(first, last):
        total = 0.0
        for y in range(volumes.shape[2]):
            _differences(volumes, scales, z, y, plain)
            _mix(mixing, plain, mixed)
            for x in range(volumes.shape[3]):
                square = 0.0
                for axis in range(3):
                    for m in range(volumes.shape[0]):
                        square += mixed[axis, m, x] * mixed[axis, m, x]
                total += np.sqrt(square)
        parts[z] = total


@njit(cache=True, nogil=True, fastmath=REORDER, error_model="numpy")
@no_type_check
def ascend(field, volumes, operator, steps, radii, first, last, room):
    """Move the field of some slices by W D x, and project it onto balls.

    Parameters
    ----------
    field : changed in place, (axis, basis, z, y, x)
    volumes : x, (basis, z, y, x)
    operator : `MixedDifferences`
    steps : length of the step of each voxel, (z, y, x)
    radii : radius of the ball of each voxel, (z, y, x)
    first, last : slices from `first` to one before `last`
    room : scratch, (2, axis, basis, x)
    """
    mixing, scales = operator.mixing, operator.scales
    plain, mixed = room[0], room[1]
    one = np.float32(1.0)
    for z in range(first, last):
        for y in range(volumes.shape[2]):
            _differences(volumes, scales, z, y, plain)
            _mix(mixing, plain, mixed)
            squares = plain[0, 0]
            for x in range(volumes.shape[3]):
                squares[x] = np.float32(0.0)
            for axis in range(3):
                for m in range(volumes.shape[0]):
                    for x in range(volumes.shape[3]):
                        moved = field[axis, m, z, y, x] + steps[z, y, x] * mixed[axis, m, x]
                        mixed[axis, m, x] = moved
                        squares[x] += moved * moved
            for x in range(volumes.shape[3]):
                radius = radii[z, y, x]
                squares[x] = radius / larger(radius, np.sqrt(squares[x])) if radius > 0.0 else np.float32(0.0)
            for axis in range(3):
                for m in range(volumes.shape[0]):
                    for x in range(volumes.shape[3]):
                        field[axis, m, z, y, x] = smaller(squares[x], one) * mixed[axis, m, x]


@reordered
@no_type_check
def _transpose_differences(entries, scales, z, y, row):
    """Write D^T of a row of one basis; `entries` is (axis, z, y, x)."""
    _, depth, height, width = entries.shape
    low, before = larger(z - 1, 0), larger(y - 1, 0)
    # The last entry along an axis has no next neighbour, the first entry has no previous one.
    down, down_before = (scales[0] if z + 1 < depth else np.float32(0.0)), (scales[0] if z > 0 else np.float32(0.0))
    along, along_before = (scales[1] if y + 1 < height else np.float32(0.0)), (scales[1] if y > 0 else np.float32(0.0))
    for x in range(width):
        row[x] = down_before * entries[0, low, y, x] - down * entries[0, z, y, x]
        row[x] += along_before * entries[1, z, before, x] - along * entries[1, z, y, x]
    for x in range(width - 1):
        row[x] -= scales[2] * entries[2, z, y, x]
    for x in range(1, width):
        row[x] += scales[2] * entries[2, z, y, x - 1]


@njit(cache=True, nogil=True, fastmath=REORDER, error_model="numpy")
@no_type_check
def gradient(field, operator, first, last, room, out):
    """Compute D^T W^T p of some slices.

    Parameters
    ----------
    field : p, (axis, basis, z, y, x)
    operator : `MixedDifferences`
    first, last : slices from `first` to one before `last`
    room : scratch, (basis, x)
    out : written, (basis, z, y, x)
    """
    mixing, scales = operator.mixing, operator.scales
    bases = field.shape[1]
    for z in range(first, last):
        for y in range(field.shape[3]):
            for m in range(bases):
                _transpose_differences(field[:, m], scales, z, y, room[m])
            for m in range(bases):
                for x in range(field.shape[4]):
                    out[m, z, y, x] = np.float32(0.0)
                for n in range(bases):
                    factor = mixing[n, m]
                    for x in range(field.shape[4]):
                        out[m, z, y, x] += factor * room[n, x]
