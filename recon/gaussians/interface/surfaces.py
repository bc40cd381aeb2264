"""Surfaces of volumes: points on them with normals, and how far around each point one plane describes them."""

from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float
from numba import njit
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.spatial import KDTree

SMOOTHING = 0.7  # voxels; standard deviation of the Gaussian that reduces noise before gradients are taken
LARGEST_SHIFT = 0.75  # voxels; furthest place of a maximum from the voxel that it is found in


class Surface(NamedTuple):
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


def ridge_points(volumes, weights, threshold):
    """Points where the length of the gradient has a maximum along the gradient.

    weights: per basis, so that weighted volumes are in one unit, in which `threshold` is (per voxel).
    """
    smooth = [w * gaussian_filter(v.astype(float), SMOOTHING, mode="nearest") for v, w in zip(volumes, weights, strict=True)]
    gradients = np.stack([np.stack(np.gradient(u)[::-1], -1) for u in smooth])  # (basis, z, y, x, 3), x first
    strength = np.sqrt((gradients**2).sum(axis=(0, -1)))
    voxels = np.argwhere(strength > threshold)
    tensor = np.einsum("mzyxa,mzyxb->abzyx", gradients, gradients)
    tensor = np.stack([gaussian_filter(t, SMOOTHING) for t in tensor.reshape(9, *strength.shape)])
    at = tuple(voxels.T)
    normals = np.linalg.eigh(tensor[(slice(None), *at)].T.reshape(-1, 3, 3))[1][:, :, 2]
    here = gradients[(slice(None), *at)]
    largest = here[np.argmax((here**2).sum(-1), axis=0), np.arange(len(voxels))]
    normals *= np.where((normals * largest).sum(1) < 0, -1, 1)[:, None]
    middle, after, before = (
        map_coordinates(strength, (voxels + o * normals[:, ::-1]).T, order=1, mode="nearest") for o in (0, 1, -1)
    )
    shift = 0.5 * (after - before) / np.maximum(2 * middle - after - before, 1e-12)
    kept = (middle >= after) & (middle >= before) & (np.abs(shift) <= LARGEST_SHIFT)
    return voxels[kept][:, ::-1] + shift[kept, None] * normals[kept], normals[kept]


def planes_of(points, normals, radii, tolerance, foreign, least):
    """Largest of some radii around each point in which a plane describes the points of a surface."""
    tree = KDTree(points)
    found = np.full(len(points), 0.7 * min(radii))
    shifts, turned = np.zeros(len(points)), normals.copy()
    todo = np.arange(len(points))
    for radius in sorted(radii, reverse=True):
        if not len(todo):
            break
        lists = tree.query_ball_point(points[todo], radius)
        ends = np.cumsum([0, *map(len, lists)])
        flat = np.concatenate([np.asarray(l, np.int64) for l in lists])
        good, shift, tilted = _planes(points, normals, todo, flat, ends, tolerance, foreign, least)
        which = todo[good]
        found[which], shifts[which], turned[which] = radius, shift[good], tilted[good]
        todo = todo[~good]
    return Surface(points, turned, found, shifts)


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def _planes(points, normals, which, neighbours, ends, tolerance, foreign, least):
    good = np.zeros(len(which), np.bool_)
    shifts, tilted = np.zeros(len(which)), np.zeros((len(which), 3))
    for k in range(len(which)):
        i = which[k]
        n = normals[i]
        a = np.array([1.0, 0.0, 0.0]) if abs(n[0]) < 0.7 else np.array([0.0, 1.0, 0.0])
        u = np.cross(a, n)
        u /= np.sqrt((u * u).sum())
        v = np.cross(n, u)
        s = np.zeros((3, 3))
        r = np.zeros(3)
        square, count, total = 0.0, 0, ends[k + 1] - ends[k]
        for at in range(ends[k], ends[k + 1]):
            j = neighbours[at]
            if (normals[j] * n).sum() < 0.5:
                continue
            d = points[j] - points[i]
            x, y, h = (d * u).sum(), (d * v).sum(), (d * n).sum()
            s[0, 0] += 1
            s[0, 1] += x
            s[0, 2] += y
            s[1, 1] += x * x
            s[1, 2] += x * y
            s[2, 2] += y * y
            r[0] += h
            r[1] += h * x
            r[2] += h * y
            square += h * h
            count += 1
        if count < least or total - count > foreign * total:
            continue
        s[1, 0], s[2, 0], s[2, 1] = s[0, 1], s[0, 2], s[1, 2]
        for m in range(3):
            s[m, m] += 1e-6
        c = np.linalg.solve(s, r)
        rest = square - (c * r).sum()
        if rest > tolerance * tolerance * count:
            continue
        m = n - c[1] * u - c[2] * v
        length = np.sqrt((m * m).sum())
        good[k], shifts[k] = True, c[0] / length
        tilted[k] = m / length
    return good, shifts, tilted
