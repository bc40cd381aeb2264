"""Numba kernel of the voxel-driven back-projector."""

from typing import no_type_check

from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def backproject(images, origins, inverses, scales, grid_origin, spacing, first, last, volume):
    """Add every view's image (view, row, column, basis) to slices `first` to `last` of `volume` (z, y, x, basis).

    A voxel takes the bilinearly interpolated pixel that its ray from the source meets, times (scale / depth)^2; depth
    is its distance from the source as a fraction of the way to the panel. Voxels seen beside the panel get nothing.
    """
    views, rows, columns, bases = images.shape
    _, height, width, _ = volume.shape
    for z in range(first, last):
        for v in range(views):
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
