"""Rectangles of a pixel that are halved where the counts bend.

A rectangle is known from rays through a grid of 5 x 5 places, corners included, but for the four that lie off the lines
through its corners and its middle: Simpson's rule on the 3 x 3 places of those lines, with twice as many places along
either side. What the latter change is added to the average, and is its estimated error as well. Whichever rectangle
has the largest one is halved across the side along which it is larger, which takes 16 rays: where surfaces intersect,
counts have a kink along a line, and lines along rows or columns are frequent.

Corners are part of the rule because any straight line that passes a rectangle leaves one of them alone.
"""

from math import sqrt
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float, Int64

from phantomgen.ops.kernel_decorators import called, inlined

# Most rays of a pixel, which bounds its time: as many as those of a grid of 64 x 64.
MOST_RAYS = 4096
# Rays of the first rectangle (5 x 5 places but four), and of halving one.
FIRST, HALVING = 21, 16
RECTANGLES = (MOST_RAYS - FIRST) // HALVING + 1
# Columns of a rectangle: its corner and sides [pixel]; its error in the worst channel, and by how much more of that is
# along its height than along its width [no unit].
LEFT, TOP, WIDTH, HEIGHT, ERROR, ACROSS = 0, 1, 2, 3, 4, 5
# Weights of Simpson's rule on [0, 1], no unit.
_SIMPSON = (1.0 / 6.0, 4.0 / 6.0, 1.0 / 6.0)


class RayList(NamedTuple):
    """Rays to be sent, pixel by pixel.

    Parameters
    ----------
    jobs : row and column of each pixel, index after its last node, and the place of its average, (.., place, place)
    nodes : offset from the centre in column and row [pixel], and weight, of each ray
    seen : signature of each ray, written when it is sent
    """

    jobs: Int64[np.ndarray, "job 5"]
    nodes: Float[np.ndarray, "node value"]
    seen: Int64[np.ndarray, " node"]

    @classmethod
    def of(cls, jobs: int, nodes: Float[np.ndarray, "node value"]) -> "RayList":
        """Allocate memory for jobs and signatures.

        Parameters
        ----------
        jobs : number of jobs
        nodes : the nodes

        Returns
        -------
        the list
        """
        return cls(np.empty((jobs, 5), dtype=np.int64), nodes, np.empty(len(nodes), dtype=np.int64))


class RectangleScratch(NamedTuple):
    """Scratch memory for the rectangles of a pixel.

    Parameters
    ----------
    table : rectangles; columns are named by `LEFT` to `ACROSS`
    counts : at the places of each rectangle
    averages : of each rectangle, times its area
    rays : to be sent for a rectangle
    """

    table: Float[np.ndarray, "rectangle 6"]
    counts: Float[np.ndarray, "channel rectangle 25"]
    averages: Float[np.ndarray, "channel rectangle"]
    rays: RayList

    @classmethod
    def of(cls, channels: int) -> "RectangleScratch":
        """Allocate the memory.

        Parameters
        ----------
        channels : number of channels

        Returns
        -------
        arrays without values
        """
        return cls(
            np.empty((RECTANGLES, 6)),
            np.empty((channels, RECTANGLES, 25)),
            np.empty((channels, RECTANGLES)),
            RayList.of(FIRST, np.empty((FIRST, 3))),
        )


@called
@no_type_check
def _add_ray(rectangles, r, place, pixel, rays, count):
    """Add the ray through a place of a rectangle to those to be sent; return their number."""
    jobs, nodes, _ = rays
    nodes[count, 0] = rectangles[r, LEFT] + 0.25 * (place % 5) * rectangles[r, WIDTH]
    nodes[count, 1] = rectangles[r, TOP] + 0.25 * (place // 5) * rectangles[r, HEIGHT]
    nodes[count, 2] = 1.0
    jobs[count, 0], jobs[count, 1], jobs[count, 2] = pixel[0], pixel[1], count + 1
    jobs[count, 3], jobs[count, 4] = r, place
    return count + 1


@called
@no_type_check
def begin_pixel(rectangles, pixel, rays):
    """Make the pixel the only rectangle.

    Parameters
    ----------
    rectangles : table of `RectangleScratch`, written
    pixel : row and column
    rays : `RayList`, written

    Returns
    -------
    number of rays to be sent
    """
    rectangles[0, LEFT], rectangles[0, TOP], rectangles[0, WIDTH], rectangles[0, HEIGHT] = -0.5, -0.5, 1.0, 1.0
    count = np.int64(0)
    for place in range(25):
        if place % 5 % 2 == 0 or place // 5 % 2 == 0:
            count = _add_ray(rectangles, np.int64(0), place, pixel, rays, count)
    return count


@called
@no_type_check
def halve(rectangles, counts, r, other, pixel, rays):
    """Halve a rectangle into itself and another one, with the counts that are known of both.

    Parameters
    ----------
    rectangles, counts : table and counts of `RectangleScratch`, written
    r, other : number of the rectangle, and of the new one
    pixel : row and column
    rays : `RayList`, written

    Returns
    -------
    number of rays to be sent
    """
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
                count = _add_ray(rectangles, at, 2 * step + j * line, pixel, rays, count)
            else:
                count = _add_ray(rectangles, at, step + j * line, pixel, rays, count)
                count = _add_ray(rectangles, at, 3 * step + j * line, pixel, rays, count)
    return count


@inlined
@no_type_check
def _bend(counts, c, r, first, step):
    """Change of Simpson's rule along a line by twice as many places."""
    ends = counts[c, r, first] + counts[c, r, first + 4 * step]
    odd = counts[c, r, first + step] + counts[c, r, first + 3 * step]
    return (4.0 * odd - 6.0 * counts[c, r, first + 2 * step] - ends) / 12.0


@called
@no_type_check
def measure(rectangles, counts, averages, r):
    """Write the averages of a rectangle, times its area.

    Parameters
    ----------
    rectangles, counts, averages : as in `RectangleScratch`; the averages are written
    r : number of the rectangle
    """
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
def estimate(rectangles, counts, totals, air, least, pixel, r):
    """Write the error of a rectangle in the worst channel, relative to the counts of the pixel.

    Parameters
    ----------
    rectangles, counts : as in `RectangleScratch`; the table is written
    totals, air : counts of all pixels with and without objects, (channel, row, column)
    least : counts are taken to be at least this part of those without objects
    pixel : row and column
    r : number of the rectangle
    """
    row, column = pixel
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
    """Find the rectangle of largest error, and the error of the whole pixel.

    Parameters
    ----------
    rectangles : table of `RectangleScratch`
    count : number of rectangles

    Returns
    -------
    number of the rectangle, and three times the root of the sum of all squared errors, whose signs are random
    """
    worst, total = np.int64(0), 0.0
    for i in range(count):
        total += rectangles[i, ERROR] * rectangles[i, ERROR]
        if rectangles[i, ERROR] > rectangles[worst, ERROR]:
            worst = np.int64(i)
    return worst, 3.0 * sqrt(total)
