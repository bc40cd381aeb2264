"""Numba kernel of the voxel-driven back-projector."""

from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float64
from numba import njit


class Views(NamedTuple):
    """Views to back-project.

    Parameters
    ----------
    sources : places of the source [mm]
    inverses : as in `recon.ops.arguments.RayFrame`
    scales : depth at which the weight is one, as a fraction of the way from source to panel
    """

    sources: Float64[np.ndarray, "view 3"]
    inverses: Float64[np.ndarray, "view 3 3"]
    scales: Float64[np.ndarray, " view"]


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def backproject(images, views, lattice, first, last, volume):
    """Add the images of all views to some slices of a volume.

    A voxel receives the bilinearly interpolated pixel on its ray from the source, times (scale / depth)^2; depth is its
    distance from the source as a fraction of the way to the panel. A voxel whose ray misses the panel receives nothing.

    Parameters
    ----------
    images : (view, row, column, basis)
    views : `Views`
    lattice : `recon.ops.arguments.Lattice`
    first, last : slices from `first` to one before `last`
    volume : added to, (z, y, x, basis)
    """
    origins, inverses, scales = views.sources, views.inverses, views.scales
    grid_origin, spacing = lattice.origin, lattice.spacing
    count, rows, columns, bases = images.shape
    _, height, width, _ = volume.shape
    for z in range(first, last):
        for v in range(count):
            m, pz = inverses[v], grid_origin[2] + z * spacing[2] - origins[v, 2]
            for y in range(height):
                py = grid_origin[1] + y * spacing[1] - origins[v, 1]
                h0 = m[0, 1] * py + m[0, 2] * pz
                h1 = m[1, 1] * py + m[1, 2] * pz
                h2 = m[2, 1] * py + m[2, 2] * pz
                for x in range(width):
                    px = grid_origin[0] + x * spacing[0] - origins[v, 0]
                    depth = h2 + m[2, 0] * px
                    column, row = (h0 + m[0, 0] * px) / depth, (h1 + m[1, 0] * px) / depth
                    if not (depth > 0 and 0 <= column <= columns - 1 and 0 <= row <= rows - 1):
                        continue
                    c, r = min(int(column), columns - 2), min(int(row), rows - 2)
                    fc, fr = column - c, row - r
                    weight = (scales[v] / depth) ** 2
                    w00, w01 = weight * (1 - fr) * (1 - fc), weight * (1 - fr) * fc
                    w10, w11 = weight * fr * (1 - fc), weight * fr * fc
                    for b in range(bases):
                        volume[z, y, x, b] += (
                            w00 * images[v, r, c, b]
                            + w01 * images[v, r, c + 1, b]
                            + w10 * images[v, r + 1, c, b]
                            + w11 * images[v, r + 1, c + 1, b]
                        )
