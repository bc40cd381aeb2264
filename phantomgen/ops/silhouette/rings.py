"""Silhouettes of tori, pixel by pixel.

The silhouette of a torus is a curve of degree eight. Within one pixel it is a conic in good approximation: along each
ray, the squared distance from the ring has one minimum, or two and a maximum between them, and the silhouette is where
one of these is the square of the tube's radius: a ray touches the torus from outside, or the hole from inside the tube.
These values are smooth in panel coordinates and, for a straight tube, quadratic polynomials. So a polynomial through
rays at the middle, corners and sides of a pixel is the form of the silhouette there.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int64
from scipy.ndimage import binary_dilation

# Most distance [pixel] between the silhouette and the conic that stands for it; pixels where it may be more, as at
# cusps, are creased.
_MISPLACED = 3e-3
# Pixels that are computed together, which bounds memory.
_BAND = 1 << 15
# Keeps quotients finite, no unit.
_TINY = 1e-300
# Places of a pixel that rays pass, in half pixels (down, right) from its centre; the last four are its corners.
_PLACES = ((0, 0), (0, -1), (0, 1), (-1, 0), (1, 0), (-1, -1), (-1, 1), (1, -1), (1, 1))
_CORNERS = slice(5, 9)
# Beside a pixel where a maximum and a minimum of the distance become one, path lengths are not smooth either.
_NEIGHBOURS = np.ones((3, 3), dtype=np.bool_)


class RingForms(NamedTuple):
    """Silhouettes of tori in the pixels that they pass, or pass near.

    Parameters
    ----------
    starts : pixel ``row * columns + column`` has the forms ``starts[pixel]`` to ``starts[pixel + 1]``
    forms : (a, b, c, d, e, f) of q = a + b u + c v + d u^2 + e u v + f v^2 relative to the pixel's centre [pixel];
        path lengths grow like sqrt(q) inside (q > 0)
    creased : True for pixels where a silhouette may pass that is no conic
    """

    starts: Int64[np.ndarray, " pixel_plus_1"]
    forms: Float[np.ndarray, "form 6"]
    creased: Bool[np.ndarray, "row column"]


def ring_forms(
    frame: Float[np.ndarray, "4 3"],
    pixels: tuple[int, int],
    locals_: Float[np.ndarray, "shape 3 4"],
    tubes: Float[np.ndarray, " shape"],
    bounds: Float[np.ndarray, "shape 4"],
    reach: float,
) -> RingForms:
    """Compute the silhouettes of tori for rays ``frame[0] + t (frame[1] + u frame[2] + v frame[3])``.

    Parameters
    ----------
    frame : source, vector from there to the centre of pixel (0, 0), column step, row step (x, y, z) [mm]
    pixels : rows and columns of the panel
    locals_ : map of each torus from world [mm] to local coordinates, where the ring and its tube reach the radius 1
    tubes : radius of the tube in local coordinates
    bounds : lowest u, highest u, lowest v, highest v of each torus [pixel]
    reach : forms are written where the silhouette may be so near [pixel]

    Returns
    -------
    the forms
    """
    rows, columns = pixels
    creased = np.zeros(pixels, dtype=np.bool_)
    cells, forms = [np.empty(0, dtype=np.int64)], [np.empty((0, 6))]
    for to_local, tube, (u_low, u_high, v_low, v_high) in zip(locals_, tubes, bounds, strict=True):
        left, right = _range(u_low, u_high, columns)
        top, bottom = _range(v_low, v_high, rows)
        height = max(_BAND // max(right - left, 1), 1)
        for first in range(top, bottom, height) if left < right else ():
            last = min(first + height, bottom)
            above, below = max(first - 1, top), min(last + 1, bottom)  # a pixel may be creased by one beside it
            inner = slice(first - above, last - above)
            for gap in _gaps(frame, to_local, tube, (left, right), (above, below)):
                own, crooked = (part[..., inner, :] for part in _conics(gap, reach))
                creased[first:last, left:right] |= crooked
                v, u = np.nonzero(np.isfinite(own[0]))
                cells.append((v + first) * columns + u + left)
                forms.append(own[:, v, u].T)
    cell = np.concatenate(cells)
    order = np.argsort(cell, kind="stable")
    starts = np.searchsorted(cell[order], np.arange(rows * columns + 1)).astype(np.int64)
    return RingForms(starts, np.ascontiguousarray(np.concatenate(forms)[order]), creased)


def _range(low: float, high: float, count: int) -> tuple[int, int]:
    """Half-open range of pixels that bounds touch."""
    first, last = np.clip([np.floor(low + 0.5), np.ceil(high + 0.5)], 0, count)
    return int(first), int(last)


def _gaps(
    frame: Float[np.ndarray, "4 3"],
    to_local: Float[np.ndarray, "3 4"],
    tube: float,
    across: tuple[int, int],
    down: tuple[int, int],
) -> Iterator[Float[np.ndarray, "place row column"]]:
    """Yield how far rays of each pixel are inside at both minima and outside at the maximum, as a squared distance.

    NaN where a ray has no such extremum. In a pixel all of whose rays have one minimum, it counts as the one near the
    source, wherever it lies.
    """
    u = np.arange(2 * across[0] - 1, 2 * across[1]) / 2
    v = np.arange(2 * down[0] - 1, 2 * down[1]) / 2
    d = (frame[1] + u[None, :, None] * frame[2] + v[:, None, None] * frame[3]) @ to_local[:, :3].T
    d /= np.linalg.norm(d, axis=-1, keepdims=True)
    origin = to_local[:, :3] @ frame[0] + to_local[:, 3]
    middle = origin - (d @ origin)[..., None] * d
    ring = 1.0 - tube
    # The quartic t^4 + p t^2 + q t + ... of `phantomgen.ops.trace.torus`, and its extrema.
    p = 2.0 * ((middle**2).sum(axis=-1) + ring**2 - tube**2) - 4.0 * ring**2 * (d[..., 0] ** 2 + d[..., 1] ** 2)
    q = -8.0 * ring**2 * (middle[..., 0] * d[..., 0] + middle[..., 1] * d[..., 1])
    least, greatest, single = _extrema(p / 2, q / 4)
    near, far, between = (
        _of_pixels(_depth(middle + t[..., None] * d, tube)) for t in (least, greatest, -least - greatest)
    )
    one, before = _of_pixels(single), _of_pixels(least < 0)
    alone = one.all(axis=0)
    yield np.where(one & ~before & ~alone, np.nan, -near)
    yield np.where((one & before) | alone, np.nan, -far)
    yield np.where(one, np.nan, between)


def _of_pixels(lattice: np.ndarray) -> np.ndarray:
    """Values at the places of each pixel, (place, row, column), of those at every half pixel."""
    down, right = lattice.shape
    return np.stack([lattice[1 + j : down - 1 + j : 2, 1 + i : right - 1 + i : 2] for j, i in _PLACES])


def _depth(points: Float[np.ndarray, "row column 3"], tube: float) -> Float[np.ndarray, "row column"]:
    """Squared distance of points from the ring, less that of the tube's surface."""
    x, y, z = np.moveaxis(points, -1, 0)
    return (np.hypot(x, y) - (1.0 - tube)) ** 2 + (z - tube) * (z + tube)


def _extrema(
    linear: Float[np.ndarray, "row column"], constant: Float[np.ndarray, "row column"]
) -> tuple[Float[np.ndarray, "row column"], Float[np.ndarray, "row column"], Bool[np.ndarray, "row column"]]:
    """Least and greatest real root of ``t^3 + linear t + constant``, and whether it is the only one, which is both."""
    discriminant = (constant / 2) ** 2 + (linear / 3) ** 3
    single = discriminant > 0
    larger = np.cbrt(np.abs(constant) / 2 + np.sqrt(np.where(single, discriminant, 0.0)))
    alone = -np.sign(constant) * (larger - linear / (3 * np.maximum(larger, _TINY)))
    radius = np.sqrt(np.maximum(-linear / 3, 0.0))
    angle = np.arccos(np.clip(-constant / 2 / np.maximum(radius**3, _TINY), -1.0, 1.0)) / 3
    least, greatest = (2 * radius * np.cos(angle + turn) for turn in (2 * np.pi / 3, 0.0))
    return np.where(single, alone, least), np.where(single, alone, greatest), single


def _conics(
    gap: Float[np.ndarray, "9 row column"], reach: float
) -> tuple[Float[np.ndarray, "6 row column"], Bool[np.ndarray, "row column"]]:
    """Form of each pixel, NaN where no silhouette is near, and whether one may pass that is no conic."""
    middle, left, right, above, below = gap[:5]
    slope_u, slope_v = right - left, below - above
    bend_u, bend_v = 2 * (right - 2 * middle + left), 2 * (below - 2 * middle + above)
    corners = gap[_CORNERS]
    twist = corners[3] - corners[2] - corners[1] + corners[0]
    steep = np.hypot(slope_u, slope_v) + (np.abs(bend_u) + np.abs(twist) + np.abs(bend_v)) / 2
    # What the polynomial misses in the corners is of third order, as is its error inside.
    missed = np.zeros(middle.shape)
    for value, (j, i) in zip(corners, _PLACES[_CORNERS], strict=True):
        there = middle + (i * slope_u + j * slope_v) / 2 + (bend_u + i * j * twist + bend_v) / 4
        missed = np.fmax(missed, np.abs(value - there))
    lacking = np.isnan(gap)
    low, high = np.fmin.reduce(gap), np.fmax.reduce(gap)
    passes = (low <= high - low) & (high >= low - high)
    ends = passes & lacking.any(axis=0) & ~lacking.all(axis=0)
    crooked = binary_dilation(ends, _NEIGHBOURS) | (passes & ~lacking.any(axis=0) & (missed > _MISPLACED * steep))
    near = ~crooked & (np.abs(middle) <= (reach + 1) * steep)
    form = np.stack([middle, slope_u, slope_v, bend_u, twist, bend_v])
    return np.where(near, form, np.nan), crooked
