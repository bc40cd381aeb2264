"""Line integrals along segments in numba, one segment at a time."""

from math import ceil, sqrt
from typing import no_type_check

from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def add_line_integrals(first, last, lengths, volumes, step, out):
    """Add the line integrals of all segments.

    Parameters
    ----------
    first, last : ends of the segments (x, y, z) [voxel], (segment, 3)
    lengths : of the segments [mm]
    volumes : values, (z, y, x, basis)
    step : largest distance of samples [voxel]
    out : line integrals, (segment, basis), added to
    """
    sizes = (volumes.shape[2], volumes.shape[1], volumes.shape[0])
    for s in range(lengths.size):
        low, high, square = 0.0, 1.0, 0.0
        for axis in range(3):  # part of the segment inside the box that holds all voxels, with half a voxel around it
            start, along = first[s, axis], last[s, axis] - first[s, axis]
            square += along * along
            if abs(along) < 1e-12:
                if start < -1.0 or start > sizes[axis]:
                    high = -1.0
                continue
            a, b = (-1.0 - start) / along, (sizes[axis] - start) / along
            low, high = max(low, min(a, b)), min(high, max(a, b))
        if high <= low:
            continue
        samples = int(ceil((high - low) * sqrt(square) / step))
        weight = (high - low) * lengths[s] / samples
        for i in range(samples):
            t = low + (i + 0.5) / samples * (high - low)
            x = first[s, 0] + t * (last[s, 0] - first[s, 0])
            y = first[s, 1] + t * (last[s, 1] - first[s, 1])
            z = first[s, 2] + t * (last[s, 2] - first[s, 2])
            _add_sample(x, y, z, volumes, weight, out[s])


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def _add_sample(x, y, z, volumes, weight, out):
    """Add the interpolated values at a point; beyond the outer voxels they fall to 0 within a voxel."""
    j, k, m = int(x + 1.0) - 1, int(y + 1.0) - 1, int(z + 1.0) - 1
    for dz in range(2):
        if not 0 <= m + dz < volumes.shape[0]:
            continue
        wz = weight * (z - m if dz else 1.0 - (z - m))
        for dy in range(2):
            if not 0 <= k + dy < volumes.shape[1]:
                continue
            wy = wz * (y - k if dy else 1.0 - (y - k))
            for dx in range(2):
                if 0 <= j + dx < volumes.shape[2]:
                    w = wy * (x - j if dx else 1.0 - (x - j))
                    for basis in range(out.size):
                        out[basis] += w * volumes[m + dz, k + dy, j + dx, basis]
