"""Surfaces of volumes: points on them with normals, and how far around each point one plane describes them."""

from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float, Int
from numba import njit
from scipy.ndimage import gaussian_filter, map_coordinates

from recon.data.volume_edges import SMOOTHING, directions_across, gradient_of, structure_tensor
from recon.gaussians.settings import SurfaceSettings

ALIKE = 0.5  # no unit; cosine of the angle between normals above which points belong to the same surface
LEAST_POINTS = 8  # points that a plane is fitted to at least; three of them determine it
FARTHEST_RIDGE = 0.75  # voxels; place of a maximum from the voxel that it is found in
SINGLE = 0.7  # of the smallest radius; that of points that no plane describes, such as those on rims
_DAMPING = 1e-6  # voxels^2; added to the normal equations of a plane, so that points in a row do not make them singular


class Surfaces(NamedTuple):
    """Points on the surfaces of volumes.

    Parameters
    ----------
    points : places (x, y, z) [voxels]
    normals : directions in which the attenuation grows, (x, y, z)
    radii : radius around each point in which a plane describes the surface [voxels]
    shifts : distance of that plane from the point along its normal [voxels]
    """

    points: Float[np.ndarray, "point 3"]
    normals: Float[np.ndarray, "point 3"]
    radii: Float[np.ndarray, " point"]
    shifts: Float[np.ndarray, " point"]


def surfaces_of(
    volumes: Float[np.ndarray, "basis z y x"], weights: Float[np.ndarray, " basis"], settings: SurfaceSettings
) -> Surfaces:
    """Find the surfaces of volumes.

    Parameters
    ----------
    volumes : coefficients of each basis, (M, Z, Y, X) [1/mm]
    weights : factors that give all bases one unit, in which large values of all together are 1 [mm]
    settings : contrast of a surface, and how far it may be from a plane

    Returns
    -------
    points where the gradient of the smoothed volumes has a maximum along its own direction
    """
    points, normals = _ridges(volumes, weights, settings)
    radii, shifts, tilted = _planes_around(points, normals, settings)
    return Surfaces(points, tilted, radii, shifts)


def _ridges(
    volumes: Float[np.ndarray, "basis z y x"], weights: Float[np.ndarray, " basis"], settings: SurfaceSettings
) -> tuple[Float[np.ndarray, "point 3"], Float[np.ndarray, "point 3"]]:
    """Find points (x, y, z) [voxels] on the ridges of the gradient, and the normals there."""
    smooth = [gaussian_filter(np.float32(w) * v, SMOOTHING) for w, v in zip(weights, volumes, strict=True)]
    gradients = [gradient_of(volume) for volume in smooth]
    tensor = structure_tensor(gradients)
    strength = np.sqrt(tensor[:3].sum(axis=0))
    at = np.nonzero(strength > settings.contrast)
    normals = directions_across(tensor, at).astype(float)
    here = np.stack([np.stack([g[at] for g in gradient[::-1]], axis=1) for gradient in gradients])  # x, y, z
    largest = here[np.argmax((here**2).sum(axis=2), axis=0), np.arange(len(normals))]
    normals *= np.where((normals * largest).sum(axis=1) < 0, -1, 1)[:, None]
    voxels = np.stack(at, axis=1)
    middle, after, before = (
        map_coordinates(strength, (voxels + step * normals[:, ::-1]).T, order=1, mode="nearest") for step in (0, 1, -1)
    )
    shift = 0.5 * (after - before) / np.maximum(2 * middle - after - before, 1e-12)  # vertex of the parabola
    ridge = (middle >= after) & (middle >= before) & (np.abs(shift) <= FARTHEST_RIDGE)
    return voxels[ridge][:, ::-1] + shift[ridge, None] * normals[ridge], normals[ridge]


def _planes_around(
    points: Float[np.ndarray, "point 3"], normals: Float[np.ndarray, "point 3"], settings: SurfaceSettings
) -> tuple[Float[np.ndarray, " point"], Float[np.ndarray, " point"], Float[np.ndarray, "point 3"]]:
    """Find the largest radius around each point in which a plane describes the surface, and that plane."""
    found, shifts = np.full(len(points), SINGLE * min(settings.radii)), np.zeros(len(points))
    tilted, todo = normals.copy(), np.arange(len(points))
    order = _Cells.of(points, max(settings.radii) / 2) if len(points) else None
    for radius in sorted(settings.radii, reverse=True):
        if order is None or not len(todo):
            break
        fits, shift, tilt = _fit_planes(points, normals, todo, order, radius, settings.tolerance, settings.foreign)
        some = todo[fits]
        found[some], shifts[some], tilted[some] = radius, shift[fits], tilt[fits]
        todo = todo[~fits]
    return found, shifts, tilted


class _Cells(NamedTuple):
    """Points sorted by cells of a grid: indices in order, where each cell starts, and the grid."""

    sorted: Int[np.ndarray, " point"]
    starts: Int[np.ndarray, " cell"]
    shape: Int[np.ndarray, " 3"]
    low: Float[np.ndarray, " 3"]
    edge: float

    @classmethod
    def of(cls, points: Float[np.ndarray, "point 3"], edge: float) -> "_Cells":
        """Sort points."""
        low = points.min(axis=0)
        index = ((points - low) / edge).astype(np.int64)
        shape = index.max(axis=0) + 1
        flat = (index[:, 0] * shape[1] + index[:, 1]) * shape[2] + index[:, 2]
        order = np.argsort(flat, kind="stable")
        starts = np.searchsorted(flat[order], np.arange(shape.prod() + 1))
        return cls(order, starts, shape, low, edge)


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def _fit_planes(points, normals, which, cells, radius, tolerance, foreign):
    """Fit a plane to the points within a radius of each of some points, by least squares of heights.

    Returns whether the plane describes them (root mean square distance below `tolerance`, fewer than the part `foreign`
    with another normal), its distance along the normal, and its own normal.
    """
    ordered, starts, shape, low, edge = cells
    fits = np.zeros(len(which), np.bool_)
    shifts, tilted = np.zeros(len(which)), np.zeros((len(which), 3))
    reach = int(np.ceil(radius / edge))
    for k in range(len(which)):
        i = which[k]
        nx, ny, nz = normals[i]
        length = np.sqrt(1 - nx * nx) if abs(nx) < 0.7 else np.sqrt(1 - ny * ny)
        if abs(nx) < 0.7:
            ux, uy, uz = 0.0, -nz / length, ny / length
        else:
            ux, uy, uz = nz / length, 0.0, -nx / length
        vx, vy, vz = ny * uz - nz * uy, nz * ux - nx * uz, nx * uy - ny * ux
        sx, sy, sxx, sxy, syy, h0, hx, hy, hh = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        count, others = 0, 0
        a0, b0, c0 = (
            int((points[i, 0] - low[0]) / edge),
            int((points[i, 1] - low[1]) / edge),
            int((points[i, 2] - low[2]) / edge),
        )
        for a in range(max(a0 - reach, 0), min(a0 + reach + 1, shape[0])):
            for b in range(max(b0 - reach, 0), min(b0 + reach + 1, shape[1])):
                for c in range(max(c0 - reach, 0), min(c0 + reach + 1, shape[2])):
                    cell = (a * shape[1] + b) * shape[2] + c
                    for at in range(starts[cell], starts[cell + 1]):
                        j = ordered[at]
                        dx, dy, dz = (
                            points[j, 0] - points[i, 0],
                            points[j, 1] - points[i, 1],
                            points[j, 2] - points[i, 2],
                        )
                        if dx * dx + dy * dy + dz * dz > radius * radius:
                            continue
                        if normals[j, 0] * nx + normals[j, 1] * ny + normals[j, 2] * nz < ALIKE:
                            others += 1
                            continue
                        x, y, h = dx * ux + dy * uy + dz * uz, dx * vx + dy * vy + dz * vz, dx * nx + dy * ny + dz * nz
                        count += 1
                        sx, sy, sxx, sxy, syy = sx + x, sy + y, sxx + x * x, sxy + x * y, syy + y * y
                        h0, hx, hy, hh = h0 + h, hx + h * x, hy + h * y, hh + h * h
        if count < LEAST_POINTS or others > foreign * (count + others):
            continue
        # normal equations about the mean place
        mx, my, mh = sx / count, sy / count, h0 / count
        cxx, cxy, cyy = sxx - count * mx * mx + _DAMPING, sxy - count * mx * my, syy - count * my * my + _DAMPING
        cx, cy = hx - count * mx * mh, hy - count * my * mh
        det = cxx * cyy - cxy * cxy
        rise_x, rise_y = (cyy * cx - cxy * cy) / det, (cxx * cy - cxy * cx) / det
        rest = hh - count * mh * mh - rise_x * cx - rise_y * cy
        if rest > tolerance * tolerance * count:
            continue
        tilt = np.sqrt(1 + rise_x * rise_x + rise_y * rise_y)
        fits[k], shifts[k] = True, (mh - rise_x * mx - rise_y * my) / tilt
        tilted[k, 0] = (nx - rise_x * ux - rise_y * vx) / tilt
        tilted[k, 1] = (ny - rise_x * uy - rise_y * vy) / tilt
        tilted[k, 2] = (nz - rise_x * uz - rise_y * vz) / tilt
    return fits, shifts, tilted
