"""Voxel projector for views whose rows are stacked along z, as those of circular and helical orbits are.

All rays of a panel's column then cross the layers at the same places, seen along z. So each layer is interpolated
across once for all rows, whole lines of voxels along z at a time. Lines along z are contiguous in memory. Where beams
are up to two voxels wide, these lines are a picture in the plane of a column's rays, and a row is the sum of what its
beam covers over all layers. Elsewhere a row takes its part from each line's running sum. Components lie side by side,
as lanes of vectors, so that places and weights are computed once for all of them; the tuple `lanes` is as long as there
are components, and its values are not used. This is many times as fast as `phantomgen.ops.project.cpu`, with the same
weights.
"""

from collections.abc import Sequence
from math import ceil, floor
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float, Float32, Int32
from numba import njit

from phantomgen.ops.kernel_decorators import inlined
from phantomgen.ops.project.cpu import _aim, _spread, _width
from phantomgen.ops.simd import load_as, splat_as, store

# Fields of the ray of each row of a column: place and slope along z [voxel], width there [voxel], and length [mm].
_PLACE, _RISE, _WIDE, _LONG = 0, 1, 2, 3
# Empty voxels before a line, where a beam may begin, and in all: at the end, a beam may begin and cover two more.
_BEFORE, PADDING = 2, 5
# Change of place per row below which rows are parallel [voxel], far above rounding, 1e-16.
_LEVEL = 1e-12


class ColumnScratch(NamedTuple):
    """Scratch memory for the rays of one column of the panel.

    Parameters
    ----------
    ray : as in `phantomgen.ops.project.cpu.BeamScratch`
    weights : of the voxels across
    rows : fields of the ray of each row
    lines, sums : a layer's lines of voxels along z, and their running sums
    """

    ray: Float[np.ndarray, " 7"]
    weights: Float[np.ndarray, " voxel"]
    rows: Float[np.ndarray, "4 row"]
    lines: Float[np.ndarray, "edge component"]
    sums: Float[np.ndarray, "edge component"]

    @classmethod
    def of(cls, shape: Sequence[int], rows: int, lanes: int, layers: int) -> "ColumnScratch":
        """Allocate the memory.

        Parameters
        ----------
        shape : number of voxels along (z, y, x)
        rows : number of rows
        lanes : number of components
        layers : number of voxels along a line

        Returns
        -------
        arrays without values
        """
        lines = np.empty((2, layers + 1, lanes))
        return cls(np.empty(7), np.empty(max(shape)), np.empty((4, rows)), lines[0], lines[1])


class PictureScratch(NamedTuple):
    """Scratch memory for layers whose beams are up to two voxels wide, which are summed together.

    Parameters
    ----------
    pictures : a line along z for each layer, with `PADDING`; empty voxels are zero on entry
    steps, sizes : t of each layer less that of the first; width of a beam there over that at the panel
    shares, places : parts of voxels that a beam covers in each layer, and where these begin
    """

    pictures: Float32[np.ndarray, "layer number"]
    steps: Float32[np.ndarray, " layer"]
    sizes: Float32[np.ndarray, " layer"]
    shares: Float32[np.ndarray, "3 end"]
    places: Int32[np.ndarray, " end"]

    @classmethod
    def of(cls, shape: Sequence[int], lanes: int) -> "PictureScratch":
        """Allocate the memory.

        Parameters
        ----------
        shape : number of voxels along (z, y, x)
        lanes : number of components

        Returns
        -------
        pictures of zeros, and arrays without values
        """
        most = max(shape[1:])
        pictures = np.zeros((most, (shape[0] + PADDING) * lanes), dtype=np.float32)
        steps, sizes = np.empty((2, most), dtype=np.float32)
        return cls(
            pictures, steps, sizes, np.empty((3, most + 1), dtype=np.float32), np.empty(most + 1, dtype=np.int32)
        )


class LineScratch(NamedTuple):
    """Scratch memory for one layer whose beams are up to two voxels wide.

    Parameters
    ----------
    shares : where each row's beam begins, and which parts of three voxels it covers
    line : of voxels along z, with `PADDING`
    """

    shares: Float[np.ndarray, "4 row"]
    line: Float32[np.ndarray, " number"]

    @classmethod
    def of(cls, rows: int, lanes: int, layers: int) -> "LineScratch":
        """Allocate the memory.

        Parameters
        ----------
        rows : number of rows
        lanes : number of components
        layers : number of voxels along a line

        Returns
        -------
        arrays without values
        """
        return cls(np.empty((4, rows)), np.empty((layers + PADDING) * lanes, dtype=np.float32))


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
    if abs(step) < _LEVEL:
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
def _draw(volume, layer, across, length, before, line):
    """Write a layer's line, interpolated across and times `length`, behind `before` empty numbers.

    A layer is its axis and number; the voxels across are the first one, their number and their weights.
    """
    (axis, k), (place, count, weights) = layer, across
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
def _sum_up(volume, layer, across, lines, sums):
    """Write a layer's lines, interpolated across, and their running sums; arguments are those of `_draw`."""
    (axis, k), (place, count, weights) = layer, across
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
def _cover(width, together, beam, drawing, count):
    """Write where in each line of a picture a beam up to two voxels wide begins, and which parts of voxels it covers.

    Places are counted from a voxel below all of the beam, which keeps 32 bits exact to 1e-6 voxels.

    Parameters
    ----------
    width, together : voxels of a line, with empty ones at its ends; numbers of each
    beam : place in the first line, where 0 is the middle of the first voxel; change of it per unit of t; width at the
        panel [voxel], or 0 for that of a voxel everywhere, which is linear interpolation
    drawing, count : `PictureScratch`, whose places and shares are written, and zeros behind the last; the third share
        is not written if the width is 0; number of lines

    Returns
    -------
    whether it meets any
    """
    first, rise, wide = beam
    _, steps, sizes, shares, places = drawing
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
def _add_drawn(lanes, drawing, layers, rows, is_wide, first, out):
    """Add the parts of the drawn layers that the beams of a column's rows cover; to `out`, flat, from `first`.

    `layers` are t of the first one and their number.
    """
    (start, drawn), shares, places = layers, drawing.shares, drawing.places
    together, picture = len(lanes), drawing.pictures.reshape(-1)
    width = drawing.pictures.shape[1] // together
    for row in range(rows.shape[1]):
        rise, wide = rows[_RISE, row], (rows[_WIDE, row] if is_wide else 0.0)
        place = rows[_PLACE, row] + start * rise
        if not _cover(width, together, (place, rise, wide), drawing, drawn):
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
def forward(lanes, volume, view, scratch, drawing, out):
    """Write the line integrals of one view.

    Parameters
    ----------
    lanes : a tuple, as long as there are components
    volume : values (y, x, z and component); there may be more x than voxels
    view : `phantomgen.ops.project.cpu.VoxelView`
    scratch, drawing : `ColumnScratch` and `PictureScratch`
    out : line integrals (column, row and component), zero on entry
    """
    frame, parallel, spacing, strides = view
    ray, weights, rows, lines, sums = scratch
    pictures, steps, sizes, _, _ = drawing
    counts, flat = strides[0], out.reshape(-1)
    last_z, together = counts[0] - 1, len(lanes)
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
                _draw(volume, (axis, k), (place, count, weights), t1 - t0, _BEFORE * together, pictures[drawn])
                steps[drawn], sizes[drawn] = t - start, size
                drawn += 1
                continue
            _sum_up(volume, (axis, k), (place, count, weights), lines, sums)
            for row in range(top, bottom):
                middle, width = rows[_PLACE, row] + t * rows[_RISE, row], max(1.0, size * rows[_WIDE, row])
                low, past_low = _edge(middle - 0.5 * width, 0, last_z)
                high, past_high = _edge(middle + 0.5 * width, 0, last_z)
                scale = (t1 - t0) * rows[_LONG, row] / width
                for c in range(together):
                    within = sums[high, c] - sums[low, c] + past_high * lines[high, c] - past_low * lines[low, c]
                    out[column, row * together + c] += scale * within
        if drawn > 0:
            _add_drawn(lanes, drawing, (start, drawn), rows, widest_drawn > 1.0, column * out.shape[1], flat)


@inlined
@no_type_check
def _share_out(rows, top, bottom, layer, low_z, last, shares):
    """Write where beams up to two voxels wide, of some rows of a column, begin in a layer's line, and their weights.

    A layer is its t, the width of a beam there over that at the panel, and its part of the ray. Lines begin `_BEFORE`
    voxels below `low_z`, and end as many as a beam may reach behind the last; a beam beside all of that has no weight.
    """
    t, size, length = layer
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
    """Write the sum of `count` rows' values (row, lane) from `first` on, times their weights, to a line (z, lane)."""
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
def _add_lines(lines, before, layer, across, volume):
    """Add a layer's lines, flat, from entry `before` on, to the voxels that the beam crosses; see `_draw`."""
    (axis, k), (place, count, weights) = layer, across
    length = volume.shape[2]
    for i in range(count):
        y, x = (k, place + i) if axis == 1 else (place + i, k)
        part = lines.dtype.type(weights[i])
        for z in range(length):
            volume[y, x, z] += part * lines[z + before]


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def backward(lanes, images, view, low_z, high_z, scratch, narrow, volume):
    """Add the pixels of one view, times their weights, to some layers of a volume.

    Parameters
    ----------
    lanes : a tuple, as long as there are components
    images : pixels (column, row and component)
    view : `phantomgen.ops.project.cpu.VoxelView`
    low_z, high_z : first and last layer of z
    scratch, narrow : `ColumnScratch` and `LineScratch`
    volume : values (y, x, z and component) of these layers, added to
    """
    frame, parallel, spacing, strides = view
    ray, weights, rows, lines, sums = scratch
    shares, drawn = narrow
    counts = strides[0]
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
                _share_out(rows, top, bottom, (t, size, t1 - t0), low_z, last, shares)
                _scatter(lanes, values, column * images.shape[1] + top * together, bottom - top, shares, drawn)
                _add_lines(drawn, _BEFORE * together, (axis, k), (place, count, weights), volume)
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
            _add_lines(lines.reshape(-1), 0, (axis, k), (place, count, weights), volume)
