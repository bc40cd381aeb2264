"""The same projector for views whose rows are stacked along z, as those of circular and helical orbits are.

All rays of a panel's column then cross the layers at the same places, seen along z. So each layer is interpolated
across once for all rows, whole lines of voxels along z at a time. Lines along z are contiguous in memory. Where beams
are up to two voxels wide, these lines are a picture in the plane of a column's rays, and a row is the sum of what its
beam covers over all layers. Elsewhere a row takes its part from each line's running sum. Components lie side by side,
as lanes of vectors, so that places and weights are computed once for all of them; the tuple `lanes` is as long as there
are components, and its values do not count. This is many times as fast as `phantomgen.ops.project.cpu`, with the same
weights.
"""

from math import ceil, floor
from typing import no_type_check

import numpy as np
from numba import njit

from phantomgen.ops.kernel_decorators import inlined
from phantomgen.ops.project.cpu import _aim, _spread, _width
from phantomgen.ops.simd import load_as, splat_as, store

# What is known of each row of a column: place and slope of its ray along z, its width there, and its length.
_PLACE, _RISE, _WIDE, _LONG = 0, 1, 2, 3
# Voxels of nothing before a line, where a beam may begin, and in all: at the end it may begin and cover two more.
_BEFORE, PADDING = 2, 5


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


@inlined
@no_type_check
def _draw(volume, axis, k, place, count, weights, length, before, line):
    """Write a layer's line, interpolated across and times `length`, behind `before` numbers of nothing."""
    y, x = (k, place) if axis == 1 else (place, k)
    part = np.float32(length * weights[0])
    if count == 1:
        for z in range(volume.shape[2]):
            line[z + before] = part * volume[y, x, z]
        return
    dy, dx = (0, 1) if axis == 1 else (1, 0)
    second = np.float32(length * weights[1])
    for z in range(volume.shape[2]):
        line[z + before] = part * volume[y, x, z] + second * volume[y + dy, x + dx, z]
    for i in range(2, count):
        part = np.float32(length * weights[i])
        for z in range(volume.shape[2]):
            line[z + before] += part * volume[y + i * dy, x + i * dx, z]


@inlined
@no_type_check
def _sum_up(volume, axis, k, place, count, weights, lines, sums):
    """Write a layer's lines, interpolated across, and their running sums."""
    depth, together = lines.shape[0] - 1, lines.shape[1]
    for c in range(together):
        sums[0, c] = 0.0
        for z in range(depth):
            lines[z, c] = 0.0
            for i in range(count):
                y, x = (k, place + i) if axis == 1 else (place + i, k)
                lines[z, c] += weights[i] * volume[y, x, z * together + c]
            sums[z + 1, c] = sums[z, c] + lines[z, c]


@inlined
@no_type_check
def _cover(width, together, first, rise, wide, steps, sizes, count, places, shares):
    """Write where in each line of a picture a beam up to two voxels wide begins, and which parts of voxels it covers.

    Places are counted from a voxel below all of the beam, which keeps 32 bits exact to 1e-6 voxels.

    Parameters
    ----------
    width, together : voxels of a line, with nothing at its ends; numbers of each
    first, rise : place in the first line, where 0 is the middle of the first voxel, and change of it per unit of t
    wide : width at the panel [voxel]; if 0, a voxel everywhere, which is linear interpolation
    steps, sizes, count : t of each line less that of the first; width there over that at the panel; how many lines
    places, shares : written, (line,) and (3, line), and nothing behind the last; the third share is not if `wide` is 0

    Returns
    -------
    whether it meets any
    """
    last, one, two = first + rise * steps[count - 1], np.float32(1.0), np.float32(2.0)
    places[count], shares[:, count] = 0, np.float32(0.0)
    lowest = min(first, last)
    if max(first, last) <= -1.5 or lowest >= width - PADDING + 0.5:
        return False
    below = np.int32(max(lowest + (_BEFORE - 0.5), 0.0))
    start, slope, across = np.float32(first + _BEFORE - below), np.float32(rise), np.float32(wide)
    low, high = np.float32(-below), np.float32(np.int32(width - 3) - below)
    firsts, seconds, thirds = shares[0], shares[1], shares[2]
    for k in range(count):
        size = max(across * sizes[k], one)
        x = min(max(start + slope * steps[k] - (size - one) / two, low), high)
        i = np.int32(x)
        places[k] = (np.int32(k) * np.int32(width) + below + i) * np.int32(together)
        past = x - np.float32(i)
        if wide == 0.0:
            firsts[k], seconds[k] = one - past, past
        else:
            rest = max(size - (one - past) - one, np.float32(0.0))
            firsts[k], seconds[k], thirds[k] = (one - past) / size, (size - (one - past) - rest) / size, rest / size
    return True


@inlined
@no_type_check
def _add_drawn(lanes, picture, width, start, steps, sizes, drawn, rows, is_wide, places, shares, first, out):
    """Add what the beams of all rows of a column cover of the layers that were drawn; to `out`, flat, from `first`."""
    together = len(lanes)
    for row in range(rows.shape[1]):
        rise, wide = rows[_RISE, row], (rows[_WIDE, row] if is_wide else 0.0)
        place = rows[_PLACE, row] + start * rise
        if not _cover(width, together, place, rise, wide, steps, sizes, drawn, places, shares):
            continue
        even = odd = further_even = further_odd = splat_as(lanes, np.float32(0.0))
        for k in range(0, drawn, 2):  # four sums, none of which waits for another
            at, beside = places[k], places[k + 1]
            even = even + load_as(lanes, picture, at) * shares[0, k]
            odd = odd + load_as(lanes, picture, beside) * shares[0, k + 1]
            further_even = further_even + load_as(lanes, picture, at + together) * shares[1, k]
            further_odd = further_odd + load_as(lanes, picture, beside + together) * shares[1, k + 1]
            if is_wide:
                even = even + load_as(lanes, picture, at + 2 * together) * shares[2, k]
                odd = odd + load_as(lanes, picture, beside + 2 * together) * shares[2, k + 1]
        total = (even + odd) + (further_even + further_odd)
        at = first + row * together
        store(out, at, load_as(lanes, out, at) + total * np.float32(rows[_LONG, row]))


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def forward(lanes, volume, frame, parallel, spacing, counts, room, drawing, out):
    """Line integrals of one view.

    Parameters
    ----------
    lanes : a tuple, as long as there are components
    volume : values (y, x, z and component); there may be more x than voxels
    frame, spacing, counts : (4, 3) in voxels, voxel sizes [mm], numbers of voxels, in the order (z, y, x)
    room : scratch: ray (7,), weights across (most voxels,), rows (4, row), lines and sums (z + 1, component)
    drawing : scratch, 32 bits: lines one after the other (most voxels, z + PADDING and component), zero on entry;
        steps and sizes of `_cover`, its shares (3, most voxels + 1), and whole numbers, its places
    out : (column, row and component), zero on entry
    """
    ray, weights, rows, lines, sums = room
    pictures, steps, sizes, shares, places = drawing
    last_z, together, picture, flat = counts[0] - 1, len(lanes), pictures.reshape(-1), out.reshape(-1)
    for column in range(out.shape[0]):
        axis, widest = _aim_rows(frame, parallel, spacing, float(column), ray, rows)
        across = 3 - axis
        wide, thick = _width(frame, ray, axis, across), 1.0 / ray[3 + axis]
        begin, end = ray[axis], ray[axis] + ray[3 + axis]
        first = int(max(0.0, floor(min(begin, end) + 0.5)))
        drawn, start, widest_drawn = 0, 0.0, 0.0
        for k in range(first, int(min(counts[axis] - 1.0, floor(max(begin, end) + 0.5))) + 1):
            t0, t1 = (k - 0.5 - begin) * thick, (k + 0.5 - begin) * thick
            t0, t1 = max(0.0, min(t0, t1)), min(1.0, max(t0, t1))
            t = 0.5 * (t0 + t1)
            size = 1.0 if parallel else t
            place, count = _spread(ray[across] + t * ray[3 + across], size * wide, 0, counts[across] - 1, weights)
            top, bottom = _near(rows, t, 0.0, float(last_z), 0.5 * widest + 1.0)
            if t1 <= t0 or count == 0 or top == bottom:
                continue
            if size * widest <= 2.0:
                start = t if drawn == 0 else start
                widest_drawn = max(widest_drawn, size * widest)
                _draw(volume, axis, k, place, count, weights, t1 - t0, _BEFORE * together, pictures[drawn])
                steps[drawn], sizes[drawn] = t - start, size
                drawn += 1
                continue
            _sum_up(volume, axis, k, place, count, weights, lines, sums)
            for row in range(top, bottom):
                middle, width = rows[_PLACE, row] + t * rows[_RISE, row], max(1.0, size * rows[_WIDE, row])
                low, past_low = _edge(middle - 0.5 * width, 0, last_z)
                high, past_high = _edge(middle + 0.5 * width, 0, last_z)
                scale = (t1 - t0) * rows[_LONG, row] / width
                for c in range(together):
                    within = sums[high, c] - sums[low, c] + past_high * lines[high, c] - past_low * lines[low, c]
                    out[column, row * together + c] += scale * within
        if drawn > 0:
            at = column * out.shape[1]
            width, is_wide = pictures.shape[1] // together, widest_drawn > 1.0
            _add_drawn(lanes, picture, width, start, steps, sizes, drawn, rows, is_wide, places, shares, at, flat)


@inlined
@no_type_check
def _share_out(rows, top, bottom, t, size, length, low_z, last, shares):
    """Write where beams up to two voxels wide, of some rows of a column, begin in a layer's line, and what they give.

    Lines begin `_BEFORE` voxels below `low_z`, and end as many as a beam may reach behind the last; a beam beside all
    of that gives nothing.
    """
    beyond, shift = last + 1.0 + _BEFORE, _BEFORE + 0.5 - low_z
    places, rises = rows[_PLACE, top:bottom], rows[_RISE, top:bottom]
    widths, lengths = rows[_WIDE, top:bottom], rows[_LONG, top:bottom]
    begins, firsts, seconds, thirds = shares[0], shares[1], shares[2], shares[3]
    for i in range(bottom - top):
        width = max(1.0, size * widths[i])
        begin = places[i] + t * rises[i] - 0.5 * width + shift
        met = begin >= 0.0 and begin < beyond
        begin = min(max(begin, 0.0), beyond)
        whole = float(int(begin))
        begun, scale = 1.0 - (begin - whole), length * lengths[i] / width if met else 0.0
        rest = max(width - begun - 1.0, 0.0)
        begins[i], firsts[i], seconds[i], thirds[i] = whole, scale * begun, scale * (width - begun - rest), scale * rest


@inlined
@no_type_check
def _scatter(lanes, values, first, count, shares, lines):
    """Write what beams of `count` rows give to a layer's line: values (row, lane) from `first` on, lines (z, lane)."""
    for i in range(lines.size):
        lines[i] = np.float32(0.0)
    together = len(lanes)
    for i in range(count):
        at, value = int(shares[0, i]) * together, load_as(lanes, values, first + i * together)
        store(lines, at, load_as(lanes, lines, at) + value * np.float32(shares[1, i]))
        at += together
        store(lines, at, load_as(lanes, lines, at) + value * np.float32(shares[2, i]))
        at += together
        store(lines, at, load_as(lanes, lines, at) + value * np.float32(shares[3, i]))


@inlined
@no_type_check
def _add_lines(lines, before, axis, k, place, count, weights, volume):
    """Add a layer's lines, flat, from entry `before` on, to the voxels that the beam crosses."""
    length = volume.shape[2]
    for i in range(count):
        y, x = (k, place + i) if axis == 1 else (place + i, k)
        part = lines.dtype.type(weights[i])
        for z in range(length):
            volume[y, x, z] += part * lines[z + before]


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def backward(lanes, images, frame, parallel, spacing, counts, low_z, high_z, room, narrow, volume):
    """Add what one view gives to the layers ``low_z <= z <= high_z`` of a volume.

    Parameters
    ----------
    images : (column, row and component)
    low_z, high_z : first and last layer
    narrow : scratch for beams up to two voxels wide: shares (4, row); 32 bits: a line (z + PADDING and component,)
    volume : (y, x, z and component), these layers only
    lanes, frame, spacing, counts, room : as in `forward`
    """
    ray, weights, rows, lines, sums = room
    shares, drawn = narrow
    last, together = high_z - low_z, len(lanes)
    values = images.reshape(-1)
    for column in range(images.shape[0]):
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
            if size * widest <= 2.0:
                _share_out(rows, top, bottom, t, size, t1 - t0, low_z, last, shares)
                _scatter(lanes, values, column * images.shape[1] + top * together, bottom - top, shares, drawn)
                _add_lines(drawn, _BEFORE * together, axis, k, place, count, weights, volume)
                continue
            lines[:], sums[:] = 0.0, 0.0
            for row in range(top, bottom):
                middle, width = rows[_PLACE, row] + t * rows[_RISE, row], max(1.0, size * rows[_WIDE, row])
                low, past_low = _edge(middle - 0.5 * width, low_z, high_z)
                high, past_high = _edge(middle + 0.5 * width, low_z, high_z)
                scale = (t1 - t0) * rows[_LONG, row] / width
                for c in range(together):
                    value = scale * images[column, row * together + c]
                    sums[high, c] += value
                    sums[low, c] -= value
                    lines[high, c] += past_high * value
                    lines[low, c] -= past_low * value
            for c in range(together):
                # A place behind edge i has all voxels before it below.
                total = 0.0
                for z in range(last, -1, -1):
                    lines[z, c] += total
                    total += sums[z, c]
            _add_lines(lines.reshape(-1), 0, axis, k, place, count, weights, volume)
