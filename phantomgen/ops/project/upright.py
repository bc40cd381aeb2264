"""The same projector for views whose rows are stacked along z, as those of circular and helical orbits are.

All rays of a panel's column then cross the layers at the same places, seen along z. So each layer is interpolated
across once for all rows, whole lines of voxels along z at a time, and a row takes its part from the line's running sum.
Lines along z are contiguous in memory. This is several times as fast as `phantomgen.ops.project.cpu`, with the same
weights.
"""

from math import ceil, floor
from typing import no_type_check

from numba import njit

from phantomgen.ops.device import inlined
from phantomgen.ops.project.cpu import _aim, _spread, _width

# What is known of each row of a column: place and slope of its ray along z, its width there, and its length.
_PLACE, _RISE, _WIDE, _LONG = 0, 1, 2, 3


@inlined
@no_type_check
def _aim_rows(frame, parallel, spacing, column, ray, rows):
    """Write the rays of all rows of a column; return their common axis, and the greatest width."""
    axis, widest = 1, 1.0
    for row in range(rows.shape[1]):
        axis = _aim(frame, parallel, spacing, column, float(row), ray)
        rows[_PLACE, row], rows[_RISE, row], rows[_LONG, row] = ray[0], ray[3], ray[6]
        rows[_WIDE, row] = _width(frame, ray, axis, 0)
        widest = max(widest, rows[_WIDE, row])
    return axis, widest


@inlined
@no_type_check
def _near(rows, t, low, high, reach):
    """First row, and the one behind the last, whose rays may be within `reach` of low <= z <= high at t."""
    count = rows.shape[1]
    begin = rows[_PLACE, 0] + t * rows[_RISE, 0]
    if count == 1:
        return 0, 1
    step = (rows[_PLACE, count - 1] + t * rows[_RISE, count - 1] - begin) / (count - 1)
    if abs(step) < 1e-12:
        return 0, count
    one, other = (low - reach - begin) / step, (high + reach - begin) / step
    first = max(0.0, min(floor(min(one, other)), float(count)))
    return int(first), int(max(first, min(ceil(max(one, other)) + 1.0, float(count))))


@inlined
@no_type_check
def _edge(place, low, high):
    """Voxel edge at or before a place, counted from that below `low`, and how far behind it the place lies."""
    x = min(max(place + 0.5 - low, 0.0), high + 1.0 - low)
    i = min(int(x), high - low)
    return i, x - i


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def forward(volume, frame, parallel, spacing, counts, room, out):
    """Line integrals of one view.

    Parameters
    ----------
    volume : values (component, y, x, z)
    frame, spacing, counts : (4, 3) in voxels, voxel sizes [mm], numbers of voxels, in the order (z, y, x)
    room : scratch: ray (7,), weights across (most voxels,), rows (4, row), lines and sums (component, z + 1)
    out : (component, row, column), zero on entry
    """
    ray, weights, rows, lines, sums = room
    last_z = counts[0] - 1
    for column in range(out.shape[2]):
        axis, widest = _aim_rows(frame, parallel, spacing, float(column), ray, rows)
        across = 3 - axis
        wide, thick = _width(frame, ray, axis, across), 1.0 / ray[3 + axis]
        begin, end = ray[axis], ray[axis] + ray[3 + axis]
        first = int(max(0.0, floor(min(begin, end) + 0.5)))
        for k in range(first, int(min(counts[axis] - 1.0, floor(max(begin, end) + 0.5))) + 1):
            t0, t1 = (k - 0.5 - begin) * thick, (k + 0.5 - begin) * thick
            t0, t1 = max(0.0, min(t0, t1)), min(1.0, max(t0, t1))
            t = 0.5 * (t0 + t1)
            size = 1.0 if parallel else t
            place, count = _spread(ray[across] + t * ray[3 + across], size * wide, 0, counts[across] - 1, weights)
            top, bottom = _near(rows, t, 0.0, float(last_z), 0.5 * widest + 1.0)
            if t1 <= t0 or count == 0 or top == bottom:
                continue
            for c in range(lines.shape[0]):
                for z in range(last_z + 1):
                    lines[c, z] = 0.0
                for i in range(count):
                    y, x = (k, place + i) if axis == 1 else (place + i, k)
                    for z in range(last_z + 1):
                        lines[c, z] += weights[i] * volume[c, y, x, z]
                sums[c, 0] = 0.0
                for z in range(last_z + 1):
                    sums[c, z + 1] = sums[c, z] + lines[c, z]
            for row in range(top, bottom):
                middle, width = rows[_PLACE, row] + t * rows[_RISE, row], max(1.0, size * rows[_WIDE, row])
                low, past_low = _edge(middle - 0.5 * width, 0, last_z)
                high, past_high = _edge(middle + 0.5 * width, 0, last_z)
                scale = (t1 - t0) * rows[_LONG, row] / width
                for c in range(lines.shape[0]):
                    within = sums[c, high] - sums[c, low] + past_high * lines[c, high] - past_low * lines[c, low]
                    out[c, row, column] += scale * within


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def backward(images, frame, parallel, spacing, counts, low_z, high_z, room, volume):
    """Add what one view (component, row, column) gives to the layers ``low_z <= z <= high_z`` of a volume.

    `volume` is (component, y, x, z) with these layers only; the rest is as in `forward`.
    """
    ray, weights, rows, lines, sums = room
    last = high_z - low_z
    for column in range(images.shape[2]):
        axis, widest = _aim_rows(frame, parallel, spacing, float(column), ray, rows)
        across = 3 - axis
        wide, thick = _width(frame, ray, axis, across), 1.0 / ray[3 + axis]
        begin, end = ray[axis], ray[axis] + ray[3 + axis]
        first = int(max(0.0, floor(min(begin, end) + 0.5)))
        for k in range(first, int(min(counts[axis] - 1.0, floor(max(begin, end) + 0.5))) + 1):
            t0, t1 = (k - 0.5 - begin) * thick, (k + 0.5 - begin) * thick
            t0, t1 = max(0.0, min(t0, t1)), min(1.0, max(t0, t1))
            t = 0.5 * (t0 + t1)
            size = 1.0 if parallel else t
            place, count = _spread(ray[across] + t * ray[3 + across], size * wide, 0, counts[across] - 1, weights)
            top, bottom = _near(rows, t, float(low_z), float(high_z), 0.5 * widest + 1.0)
            if t1 <= t0 or count == 0 or top == bottom:
                continue
            for c in range(lines.shape[0]):
                for z in range(last + 1):
                    lines[c, z] = sums[c, z] = 0.0
            for row in range(top, bottom):
                middle, width = rows[_PLACE, row] + t * rows[_RISE, row], max(1.0, size * rows[_WIDE, row])
                low, past_low = _edge(middle - 0.5 * width, low_z, high_z)
                high, past_high = _edge(middle + 0.5 * width, low_z, high_z)
                scale = (t1 - t0) * rows[_LONG, row] / width
                for c in range(lines.shape[0]):
                    value = scale * images[c, row, column]
                    sums[c, high] += value
                    sums[c, low] -= value
                    lines[c, high] += past_high * value
                    lines[c, low] -= past_low * value
            for c in range(lines.shape[0]):
                # A place behind edge i has all voxels before it below.
                total = 0.0
                for z in range(last, -1, -1):
                    lines[c, z] += total
                    total += sums[c, z]
                for i in range(count):
                    y, x = (k, place + i) if axis == 1 else (place + i, k)
                    for z in range(last + 1):
                        volume[c, y, x, z] += weights[i] * lines[c, z]
