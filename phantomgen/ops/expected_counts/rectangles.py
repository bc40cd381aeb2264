"""Rectangles of a pixel that are halved where the counts bend.

A rectangle is known from rays through a grid of 5 x 5 places, corners included, but for the four that lie off the lines
through its corners and its middle: Simpson's rule on the 3 x 3 places of those lines, with twice as many places along
either side. What the latter change is added to the average, and is its estimated error as well. Whichever rectangle
has the largest one is halved across the side along which it is larger, which takes 16 rays: where surfaces intersect,
counts have a kink along a line, and lines along rows or columns are frequent.

Corners are part of the rule because any straight line that passes a rectangle leaves one of them alone.
"""

from math import sqrt
from typing import no_type_check

import numpy as np

from phantomgen.ops.kernel_decorators import called, inlined

# Most rays of a pixel; rays of the first rectangle and of halving one.
MOST_RAYS = 4096
FIRST, HALVING = 21, 16
RECTANGLES = (MOST_RAYS - FIRST) // HALVING + 1
# Columns of a rectangle: its corner and sides, error along either side, and the larger one over all channels.
LEFT, TOP, WIDTH, HEIGHT, ERROR, ACROSS = 0, 1, 2, 3, 4, 5
_SIMPSON = (1.0 / 6.0, 4.0 / 6.0, 1.0 / 6.0)


def scratch(channels: int):
    """Rectangles, counts at their places (channel, rectangle, place), their averages; jobs, nodes and signatures."""
    return (
        np.empty((RECTANGLES, 6)),
        np.empty((channels, RECTANGLES, 25)),
        np.empty((channels, RECTANGLES)),
        np.empty((FIRST, 5), dtype=np.int64),
        np.empty((FIRST, 3)),
        np.empty(FIRST, dtype=np.int64),
    )


@called
@no_type_check
def _ask(rectangles, r, place, pixel, jobs, nodes, count):
    """Add the ray through a place of a rectangle to those to be sent; return their number."""
    nodes[count, 0] = rectangles[r, LEFT] + 0.25 * (place % 5) * rectangles[r, WIDTH]
    nodes[count, 1] = rectangles[r, TOP] + 0.25 * (place // 5) * rectangles[r, HEIGHT]
    nodes[count, 2] = 1.0
    jobs[count, 0], jobs[count, 1], jobs[count, 2] = pixel[0], pixel[1], count + 1
    jobs[count, 3], jobs[count, 4] = r, place
    return count + 1


@called
@no_type_check
def begin_pixel(rectangles, pixel, jobs, nodes):
    """Make the pixel the only rectangle; return the number of rays to be sent."""
    rectangles[0, LEFT], rectangles[0, TOP], rectangles[0, WIDTH], rectangles[0, HEIGHT] = -0.5, -0.5, 1.0, 1.0
    count = np.int64(0)
    for place in range(25):
        if place % 5 % 2 == 0 or place // 5 % 2 == 0:
            count = _ask(rectangles, np.int64(0), place, pixel, jobs, nodes, count)
    return count


@called
@no_type_check
def halve(rectangles, counts, r, other, pixel, jobs, nodes):
    """Halve rectangle `r` into itself and `other`, with what is known of both; return the number of rays to be sent."""
    down = rectangles[r, ACROSS] > 0.0
    step, line = (5, 1) if down else (1, 5)
    side, edge = (HEIGHT, TOP) if down else (WIDTH, LEFT)
    rectangles[r, side] *= 0.5
    for i in range(4):
        rectangles[other, i] = rectangles[r, i]
    rectangles[other, edge] += rectangles[r, side]
    for c in range(counts.shape[0]):
        for j in range(5):
            for i in range(3):
                counts[c, other, 2 * i * step + j * line] = counts[c, r, (2 + i) * step + j * line]
            for i in range(2, -1, -1):
                counts[c, r, 2 * i * step + j * line] = counts[c, r, i * step + j * line]
    count = np.int64(0)
    for half in range(2):
        at = other if half else r
        for j in range(5):
            if j % 2:
                count = _ask(rectangles, at, 2 * step + j * line, pixel, jobs, nodes, count)
            else:
                count = _ask(rectangles, at, step + j * line, pixel, jobs, nodes, count)
                count = _ask(rectangles, at, 3 * step + j * line, pixel, jobs, nodes, count)
    return count


@inlined
@no_type_check
def _bend(counts, c, r, first, step):
    """What twice as many places along a line change of Simpson's rule."""
    ends = counts[c, r, first] + counts[c, r, first + 4 * step]
    odd = counts[c, r, first + step] + counts[c, r, first + 3 * step]
    return (4.0 * odd - 6.0 * counts[c, r, first + 2 * step] - ends) / 12.0


@called
@no_type_check
def measure(rectangles, counts, averages, r):
    """Write the averages of a rectangle, times its area."""
    area = rectangles[r, WIDTH] * rectangles[r, HEIGHT]
    for c in range(counts.shape[0]):
        average = 0.0
        for j in range(3):
            for i in range(3):
                average += _SIMPSON[j] * _SIMPSON[i] * counts[c, r, 10 * j + 2 * i]
            average += _SIMPSON[j] * (_bend(counts, c, r, 10 * j, 1) + _bend(counts, c, r, 2 * j, 5))
        averages[c, r] = area * average


@called
@no_type_check
def estimate(rectangles, counts, totals, air, least, row, column, r):
    """Write the error of a rectangle in the worst channel, relative to the counts of the pixel."""
    area = rectangles[r, WIDTH] * rectangles[r, HEIGHT]
    rectangles[r, ERROR], rectangles[r, ACROSS] = 0.0, 0.0
    for c in range(counts.shape[0]):
        along = down = 0.0
        for j in range(3):
            along += _SIMPSON[j] * abs(_bend(counts, c, r, 10 * j, 1))
            down += _SIMPSON[j] * abs(_bend(counts, c, r, 2 * j, 5))
        error = area * (along + down) / max(totals[c, row, column], least * air[c, row, column])
        if error > rectangles[r, ERROR]:
            rectangles[r, ERROR], rectangles[r, ACROSS] = error, down - along


@called
@no_type_check
def worst_of(rectangles, count):
    """The rectangle of largest error, and thrice the root of the sum of all squared errors, whose signs are random."""
    worst, total = np.int64(0), 0.0
    for i in range(count):
        total += rectangles[i, ERROR] * rectangles[i, ERROR]
        if rectangles[i, ERROR] > rectangles[worst, ERROR]:
            worst = np.int64(i)
    return worst, 3.0 * sqrt(total)
