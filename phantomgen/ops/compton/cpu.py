"""Single scatter in numba, one pixel at a time."""

from math import exp, sqrt
from typing import no_type_check

import numpy as np
from numba import njit

from phantomgen.ops.compton.inputs import NARROW
from phantomgen.ops.kernel_decorators import inlined
from spectra.elements.constants import ELECTRON_REST_ENERGY


@inlined
@no_type_check
def _dot(ax, ay, az, bx, by, bz):
    """Scalar product."""
    return ax * bx + ay * by + az * bz


@inlined
@no_type_check
def _between(table, position, column):
    """Value of a column of a table at a position between its rows."""
    row = int(position)
    part = position - row
    return table[row, column] + part * (table[row + 1, column] - table[row, column])


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def add_scattered(pixel, area, source, points, lengths, energies, out):
    """Add the signal that all points scatter to a pixel.

    Parameters
    ----------
    pixel, area, source, points, lengths, energies : as in `phantomgen.ops.compton.scattered_to`
    out : signal of each group, added to
    """
    place, strength, photons = points
    edges, step, attenuation, measured = energies
    for j in range(strength.size):
        ix, iy, iz = place[j, 0] - source[0], place[j, 1] - source[1], place[j, 2] - source[2]
        ox, oy, oz = pixel[0] - place[j, 0], pixel[1] - place[j, 1], pixel[2] - place[j, 2]
        near2, far2 = _dot(ix, iy, iz, ix, iy, iz), _dot(ox, oy, oz, ox, oy, oz)
        cosine = _dot(ix, iy, iz, ox, oy, oz) / sqrt(near2 * far2)
        facing = abs(_dot(ox, oy, oz, area[0], area[1], area[2]))
        factor = strength[j] * facing / (near2 * far2 * sqrt(far2))
        for b in range(edges.size - 1):
            energy = 0.5 * (edges[b] + edges[b + 1])
            k = 1.0 / (1.0 + energy / ELECTRON_REST_ENERGY * (1.0 - cosine))
            row = int(np.rint(k * energy / step))
            weakened = 0.0
            for m in range(lengths.shape[1]):
                weakened += lengths[j, m] * attenuation[row, m]
            sent = factor * photons[j, b] * exp(-weakened) * k * k * (k + 1.0 / k - 1.0 + cosine * cosine)
            half = 0.5 * max(k * (edges[b + 1] - edges[b]), NARROW)
            low, high = (k * energy - half) / step, (k * energy + half) / step
            for group in range(out.size):
                seen = _between(measured, high, group) - _between(measured, low, group)
                out[group] += sent * seen / (2.0 * half)
