"""Where divided Gaussians begin: on surfaces, as far apart as a plane describes the surface, and plain ones inside."""

from typing import no_type_check

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from numba import njit
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.spatial import KDTree
from torch import Tensor

from phantomgen.geometry.voxel_grid import Grid
from recon.data.volume_edges import SMOOTHING, large_signal
from recon.gaussians.divided.model import DividedGaussians
from recon.gaussians.divided.surfaces import surfaces_of
from recon.gaussians.initial.initialize import neighbour_distance, places_of, random_of_places
from recon.gaussians.initial.wanted_count import places_for
from recon.gaussians.settings import SurfaceSettings
from spectra.threads import thread_count

BEYOND = 8.0  # standard deviations; where the plane of a plain Gaussian is put, further than any line meets it


def place_on_surfaces(
    volumes: Float[np.ndarray, "basis z y x"],
    grid: Grid,
    metric: Float[np.ndarray, "basis basis"],
    basis_names: tuple[str, ...],
    seed: int,
    settings: SurfaceSettings,
) -> DividedGaussians:
    """Place divided Gaussians on the surfaces of volumes, and plain ones elsewhere.

    Parameters
    ----------
    volumes : estimate of each basis, (M, Z, Y, X) [1/mm]
    grid : voxels of `volumes`
    metric : weights of the bases, diagonal, from `recon.gaussians.initial.fit_to_volume.metric_of` [mm^2]
    basis_names : names of the bases
    seed : of the placement
    settings : distances, overlap and contrast

    Returns
    -------
    first Gaussians, with the values of the volumes on either side of their planes, over the sum of all Gaussians there
    """
    voxel, weights = min(grid.spacing), _weights(volumes, metric)
    surfaces = surfaces_of(volumes, weights, settings)
    apart = np.clip(settings.spacing * surfaces.radii, settings.finest, settings.coarsest)
    inside = _places_inside(volumes, weights, grid, seed, settings)
    apart_inside = np.full(len(inside), settings.coarsest)
    if len(apart):
        distance, nearest = KDTree(surfaces.points).query(inside, workers=thread_count())
        apart_inside = np.minimum(apart_inside, apart[nearest] + settings.growth * distance)
    places, distances = np.concatenate([surfaces.points, inside]), np.concatenate([apart, apart_inside])
    on_surface = np.arange(len(places)) < len(apart)
    random = random_of_places(np.floor(places[:, ::-1] + 0.5).astype(np.int64) + places_of(grid), seed)[:, 3]
    factor, kept = places_for(settings.count, lambda factor: _spread(places, factor * distances, on_surface, random))
    centres, on_surface = places[kept], on_surface[kept]
    sigma = settings.overlap * neighbour_distance(centres, settings.neighbours, default=factor * settings.finest)
    count = int(on_surface.sum())  # those on surfaces come first
    normals = np.tile([0.0, 0.0, 1.0], (len(centres), 1))
    normals[:count] = surfaces.normals[kept[:count]]
    offsets = np.where(on_surface, 0.0, -BEYOND * sigma)
    offsets[:count] = surfaces.shifts[kept[:count]]
    values = _values_beside(volumes, centres, normals, np.where(on_surface, _reach(sigma), 0.0))
    origin, spacing = np.array(grid.origin)[::-1], np.array(grid.spacing)[::-1]
    model = DividedGaussians(
        _tensor(origin + centres * spacing),
        _tensor(np.log(np.repeat(sigma[:, None] * voxel, 3, axis=1))),
        _tensor(_turns_to(normals)),
        _tensor(offsets * voxel),
        torch.ones(len(centres), 2, 1),
        basis_names,
        settings.first_width * voxel,
    )
    density = model.voxels(grid)[0].numpy()
    sums = map_coordinates(density, centres[:, ::-1].T, order=1, mode="nearest")
    return model.with_values(_tensor(values / np.maximum(sums, settings.least_sum)[:, None, None]))


def _tensor(values: Float[np.ndarray, "..."]) -> Float[Tensor, "..."]:
    """Convert an array to float32."""
    return torch.from_numpy(np.ascontiguousarray(values)).float()


def _weights(
    volumes: Float[np.ndarray, "basis z y x"], metric: Float[np.ndarray, "basis basis"]
) -> Float[np.ndarray, " basis"]:
    """Compute factors that give all bases one unit, in which large values of all bases together are 1."""
    weights = np.sqrt(np.diag(metric))
    signal = np.sqrt(sum((w * v) ** 2 for w, v in zip(weights, volumes, strict=True)))
    return weights / max(large_signal(signal), 1e-30)


def _places_inside(
    volumes: Float[np.ndarray, "basis z y x"],
    weights: Float[np.ndarray, " basis"],
    grid: Grid,
    seed: int,
    settings: SurfaceSettings,
) -> Float[np.ndarray, "place 3"]:
    """Choose a place (x, y, z) [voxels] in every voxel that is not empty; the places belong to the voxels."""
    square = sum((w * gaussian_filter(v, SMOOTHING)) ** 2 for v, w in zip(volumes, weights, strict=True))
    voxels = np.argwhere(square > settings.empty**2)
    return (voxels + random_of_places(voxels + places_of(grid), seed)[:, :3] - 0.5)[:, ::-1]


def _reach(sigma: Float[np.ndarray, " gaussian"]) -> Float[np.ndarray, " gaussian"]:
    """Choose how far from a surface its two sides are looked at [voxels]: past the blur, within the Gaussian."""
    return np.minimum(1.8, 1.2 * sigma + 0.6)


def _values_beside(
    volumes: Float[np.ndarray, "basis z y x"],
    centres: Float[np.ndarray, "gaussian 3"],
    normals: Float[np.ndarray, "gaussian 3"],
    reach: Float[np.ndarray, " gaussian"],
) -> Float[np.ndarray, "gaussian 2 basis"]:
    """Take the values of the volumes on either side of each centre [1/mm]."""
    smooth = [gaussian_filter(v, 0.5) for v in volumes]
    sides = []
    for side in (-1, 1):
        at = (centres + side * reach[:, None] * normals)[:, ::-1].T
        sides.append(np.stack([map_coordinates(v, at, order=1, mode="nearest") for v in smooth], axis=1))
    return np.maximum(np.stack(sides, axis=1), 0)


def _turns_to(normals: Float[np.ndarray, "gaussian 3"]) -> Float[np.ndarray, "gaussian 4"]:
    """Compute the quaternions (w, x, y, z) of the shortest rotation from +z to each normal; about x to -z."""
    x, y, z = normals.T
    quaternions = np.stack([1 + z, -y, x, np.zeros(len(z))], axis=1)
    quaternions[z < -1 + 1e-9] = (0, 1, 0, 0)
    return quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)


def _spread(
    places: Float[np.ndarray, "place 3"],
    distances: Float[np.ndarray, " place"],
    first: Bool[np.ndarray, " place"],
    random: Float[np.ndarray, " place"],
) -> Int[np.ndarray, " some"]:
    """Choose places that keep their distance, those of `first` before others, and the finest before wider ones."""
    low, edge = places.min(axis=0), float(np.clip(np.quantile(distances, 0.1), 0.5, None))
    cells = ((places.max(axis=0) - low) / edge).astype(np.int64) + 1
    order = np.lexsort([random, np.round(distances, 1), ~first])  # equal tenths of a voxel in random order
    taken = order[_throw_darts(places, distances, order, edge, low, cells)]
    return np.concatenate([np.sort(taken[first[taken]]), np.sort(taken[~first[taken]])])


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def _throw_darts(places, distances, order, edge, low, cells):
    """Accept places in order, unless one is already closer than the place's own distance; True per entry of `order`."""
    newest = np.full(cells[0] * cells[1] * cells[2], -1)
    older = np.full(len(places), -1)
    taken = np.zeros(len(order), np.bool_)
    for k in range(len(order)):
        i = order[k]
        a0, b0, c0 = (
            int((places[i, 0] - low[0]) / edge),
            int((places[i, 1] - low[1]) / edge),
            int((places[i, 2] - low[2]) / edge),
        )
        reach, square = int(distances[i] / edge) + 1, distances[i] ** 2
        free = True
        for a in range(max(a0 - reach, 0), min(a0 + reach + 1, cells[0])):
            for b in range(max(b0 - reach, 0), min(b0 + reach + 1, cells[1])):
                for c in range(max(c0 - reach, 0), min(c0 + reach + 1, cells[2])):
                    j = newest[(a * cells[1] + b) * cells[2] + c]
                    while j >= 0 and free:
                        x, y, z = places[i, 0] - places[j, 0], places[i, 1] - places[j, 1], places[i, 2] - places[j, 2]
                        free = x * x + y * y + z * z >= square
                        j = older[j]
                    if not free:
                        break
                if not free:
                    break
            if not free:
                break
        if free:
            taken[k] = True
            cell = (a0 * cells[1] + b0) * cells[2] + c0
            older[i], newest[cell] = newest[cell], i
    return taken
