"""Where divided Gaussians begin: on surfaces, as far apart as a plane describes the surface, and plain ones inside."""

from dataclasses import dataclass
from typing import no_type_check

import numpy as np
import torch
from jaxtyping import Float
from numba import njit
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.spatial import KDTree

from phantomgen.geometry.voxel_grid import Grid
from recon.gaussians.interface.model import DividedGaussians
from recon.gaussians.interface.surfaces import planes_of, ridge_points


@dataclass(frozen=True)
class SurfacePlacement:
    """How divided Gaussians are placed; lengths in voxels.

    Parameters
    ----------
    spacing : distance between Gaussians on a surface over the radius in which a plane describes it [no unit]
    finest, coarsest : smallest and largest distance [voxels]
    growth : increase of the distance per distance from a surface [no unit]
    overlap : standard deviation over the distance to the neighbours [no unit]
    threshold : smallest gradient of a surface, over the peak [1/voxel]
    tolerance : root mean square distance of a surface from its plane [voxels]
    width : first width of the transition [voxels]
    """

    spacing: float = 0.9
    finest: float = 1.5
    coarsest: float = 9.0
    growth: float = 0.5
    overlap: float = 0.65
    threshold: float = 0.02
    tolerance: float = 0.15
    foreign: float = 0.03
    radii: tuple[float, ...] = (9.0, 7.0, 5.0, 3.5, 2.5)
    occupied: float = 0.02
    width: float = 0.3
    seed: int = 0


def place(volumes: Float[np.ndarray, "basis z y x"], grid: Grid, metric: np.ndarray, names, settings: SurfacePlacement):
    """Place divided Gaussians; `metric` diagonal, in which differences of bases are measured."""
    voxel, bases = min(grid.spacing), len(volumes)
    weights = np.sqrt(np.diag(metric))
    weights = weights / max(w * np.quantile(v[v > 0], 0.999) for w, v in zip(weights, volumes, strict=True) if (v > 0).any())
    points, normals = ridge_points(volumes, weights, settings.threshold)
    surface = planes_of(points, normals, settings.radii, settings.tolerance, settings.foreign, 8)
    apart = np.clip(settings.spacing * surface.radii, settings.finest, settings.coarsest)
    level = np.sqrt(sum((w * gaussian_filter(v.astype(float), 0.7)) ** 2 for w, v in zip(weights, volumes, strict=True)))
    random = np.random.default_rng(settings.seed)
    inside = np.argwhere(level > settings.occupied)[:, ::-1].astype(float)
    inside += random.uniform(-0.5, 0.5, inside.shape)
    distance, nearest = KDTree(points).query(inside)
    apart_inside = np.minimum(settings.coarsest, apart[nearest] + settings.growth * distance)
    places, distances = np.concatenate([points, inside]), np.concatenate([apart, apart_inside])
    order = np.lexsort([random.random(len(places)), np.round(distances, 1), np.arange(len(places)) >= len(points)])
    taken = _thin(places, distances, order)
    on, off = np.flatnonzero(taken[: len(points)]), np.flatnonzero(taken[len(points) :])
    centres = np.concatenate([points[on], inside[off]])
    neighbours = KDTree(centres).query(centres, k=min(7, len(centres)))[0][:, 1:]
    sigma = settings.overlap * np.sqrt((neighbours**2).mean(axis=1))
    directions = np.concatenate([surface.normals[on], np.tile([0.0, 0, 1], (len(off), 1))])
    shifts = np.concatenate([surface.shifts[on], -8 * sigma[len(on) :]])
    smooth = [gaussian_filter(v.astype(float), 0.5) for v in volumes]
    reach = np.where(np.arange(len(centres)) < len(on), np.minimum(1.8, 1.2 * sigma + 0.6), 0.0)[:, None]
    sides = [
        np.stack([map_coordinates(v, (centres + s * reach * directions)[:, ::-1].T, order=1, mode="nearest") for v in smooth], 1)
        for s in (-1, 1)
    ]
    values = np.maximum(np.stack(sides, 1), 0)
    t = lambda a: torch.from_numpy(np.ascontiguousarray(a)).float()  # noqa: E731
    origin, spacing = np.array(grid.origin)[::-1], np.array(grid.spacing)[::-1]
    model = DividedGaussians(
        t(origin + centres * spacing), t(np.log(sigma * voxel)[:, None].repeat(3, 1)), t(_turns(directions)),
        t(shifts * voxel), t(np.ones((len(centres), 2, 1))), tuple(names), settings.width * voxel,
    )
    density = model.voxels(grid, 3.7)[0].numpy()
    sums = map_coordinates(density, centres[:, ::-1].T, order=1, mode="nearest")
    return model.with_values(t(values / np.maximum(sums, 0.5)[:, None, None]))


def _turns(normals):
    """Quaternions (w, x, y, z) of rotations from +z to each normal."""
    w = 1 + normals[:, 2]
    q = np.stack([w, -normals[:, 1], normals[:, 0], np.zeros(len(w))], 1)
    q[w < 1e-6] = [0, 1, 0, 0]
    return q / np.linalg.norm(q, axis=1, keepdims=True)


def _thin(places, distances, order):
    low = places.min(axis=0) - 1
    cell = max(float(np.quantile(distances, 0.1)), 0.5)
    cells = ((places.max(axis=0) - low) / cell).astype(np.int64) + 2
    return _throw_darts(places, distances, order, cell, low, cells)


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def _throw_darts(places, distances, order, cell, low, cells):
    first = np.full(cells[0] * cells[1] * cells[2], -1)
    following = np.full(len(places), -1)
    taken = np.zeros(len(places), np.bool_)
    for o in order:
        at = ((places[o] - low) / cell).astype(np.int64)
        k = int(distances[o] / cell) + 1
        free = True
        for a in range(max(at[0] - k, 0), min(at[0] + k + 1, cells[0])):
            for b in range(max(at[1] - k, 0), min(at[1] + k + 1, cells[1])):
                for c in range(max(at[2] - k, 0), min(at[2] + k + 1, cells[2])):
                    j = first[(a * cells[1] + b) * cells[2] + c]
                    while j >= 0 and free:
                        d = places[o] - places[j]
                        if (d * d).sum() < distances[o] ** 2:
                            free = False
                        j = following[j]
                    if not free:
                        break
                if not free:
                    break
            if not free:
                break
        if free:
            taken[o] = True
            h = (at[0] * cells[1] + at[1]) * cells[2] + at[2]
            following[o] = first[h]
            first[h] = o
    return taken
