"""First Gaussians, placed by the voxel volumes of the bases: close to each other along edges, further apart inside."""

from typing import no_type_check

import numpy as np
import torch
from jaxtyping import Bool, Float, Int, UInt64
from numba import njit
from scipy.ndimage import gaussian_filter, map_coordinates, minimum_filter
from scipy.spatial import KDTree

from phantomgen.geometry.voxel_grid import Grid
from recon.data.volume_edges import SMOOTHING, VolumeEdges, directions_across
from recon.gaussians.initial.wanted_count import places_for
from recon.gaussians.model import Gaussians
from recon.gaussians.settings import PlacementSettings
from recon.ops.voxelize import voxelize
from spectra.threads import thread_count

DEFAULT = PlacementSettings()
BLOCK = 8  # voxels; edge of blocks that order Gaussians; measured: unordered, the fit to volumes takes 3 times as long
_GOLDEN = 0x9E3779B97F4A7C15  # no unit; increment of SplitMix64: the odd number nearest to 2^64 over the golden ratio


def initialize(
    volumes: Float[np.ndarray, "basis z y x"],
    grid: Grid,
    fisher: Float[np.ndarray, "basis basis"],
    spacing: float,
    basis_names: tuple[str, ...],
    seed: int,
    settings: PlacementSettings = DEFAULT,
) -> Gaussians:
    """Place Gaussians where the volumes are not empty.

    Signal and edges are measured in units of noise (volumes whitened by the mean Fisher matrix), so that the choice of
    bases does not matter. Gaussians keep a distance of `spacing` along edges, and a larger one inside; their scales
    follow from the distance to their neighbours; their coefficients are the values of the volumes over the sum of all
    Gaussians there.

    Parameters
    ----------
    volumes : estimate of each basis, (M, Z, Y, X) [1/mm]
    grid : grid of `volumes`
    fisher : mean Fisher matrix of the rays' line integrals, (M, M) [no unit]
    spacing : distance between Gaussians along edges [mm]
    basis_names : names of the bases
    seed : seed of the placement
    settings : distances, overlap and shape

    Returns
    -------
    first Gaussians
    """
    smooth = np.stack([gaussian_filter(v, SMOOTHING) for v in volumes])
    structure = VolumeEdges.of(volumes, fisher)
    distance = _wanted_distance(structure, grid, spacing, settings)
    apart, first = distance / min(grid.spacing), places_of(grid)
    factor, voxel = places_for(settings.count, lambda f: _blue_noise(structure.occupied, f * apart, first, seed))
    centres = (np.array(grid.origin) + voxel * np.array(grid.spacing))[:, ::-1].copy()
    scales = neighbour_distance(centres, settings.neighbours, default=factor * spacing) * settings.overlap
    normals, edge = _normals(structure, voxel)
    thickness = settings.flatness**edge
    flat = np.stack([thickness**-0.25, thickness**-0.25, thickness**0.75], axis=1)  # thinner, and a little wider
    parts = (
        torch.from_numpy(centres).float(),
        torch.log(torch.from_numpy(scales[:, None] * flat)).float(),
        torch.from_numpy(turn_z_to(normals)).float(),
    )
    values = np.stack([map_coordinates(v, voxel.T, order=1, mode="nearest") for v in np.maximum(smooth, 0)], axis=1)
    density = voxelize(*parts, torch.ones(len(centres), 1), grid)[0]
    sums = map_coordinates(density, voxel.T, order=1, mode="nearest")
    coefficients = values / np.maximum(sums, settings.least_sum)[:, None]
    return Gaussians(*parts, torch.from_numpy(coefficients).float(), basis_names)


def _wanted_distance(
    structure: VolumeEdges, grid: Grid, finest: float, settings: PlacementSettings
) -> Float[np.ndarray, "z y x"]:
    """Compute the wanted distance between Gaussians [mm]: `finest` at edges, growing away from them."""
    distance = finest / np.maximum(structure.strength, 1e-6)
    distance = np.clip(distance, finest, settings.coarsest * finest)
    step = settings.growth * min(grid.spacing)
    for _ in range(int(np.ceil((settings.coarsest - 1) * finest / step))):
        distance = np.minimum(distance, minimum_filter(distance, size=3) + step)
    return distance


def _normals(
    structure: VolumeEdges, voxel: Float[np.ndarray, "point 3"]
) -> tuple[Float[np.ndarray, "point 3"], Float[np.ndarray, " point"]]:
    """Find the direction (x, y, z) across the edge at each point, and the strength of the edge there, 0 to 1."""
    index = tuple(np.clip(np.round(voxel).astype(int).T, 0, np.array(structure.occupied.shape)[:, None] - 1))
    return directions_across(structure.tensor, index), np.clip(structure.strength[index], 0, 1)


def turn_z_to(normals: Float[np.ndarray, "point 3"]) -> Float[np.ndarray, "point 4"]:
    """Compute the quaternions (w, x, y, z) of the shortest rotation from +z to each normal.

    Parameters
    ----------
    normals : directions (x, y, z), of length 1

    Returns
    -------
    quaternions, one per direction
    """
    up = np.where(normals[:, 2:] < 0, -normals, normals)
    quaternions = np.stack([1 + up[:, 2], -up[:, 1], up[:, 0], np.zeros(len(up))], axis=1)
    return quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def _throw_darts(voxels, offsets, distances, shape, taken):
    """Accept points in order, unless one is already closer than the candidate's distance; all in voxels."""
    accepted = np.empty(len(voxels), np.int64)
    count = 0
    for i in range(len(voxels)):
        reach = int(np.ceil(distances[i])) + 1
        z, y, x = voxels[i]
        free = True
        for a in range(max(z - reach, 0), min(z + reach + 1, shape[0])):
            for b in range(max(y - reach, 0), min(y + reach + 1, shape[1])):
                for c in range(max(x - reach, 0), min(x + reach + 1, shape[2])):
                    j = taken[a, b, c]
                    if j < 0:
                        continue
                    dz = a - z + offsets[j, 0] - offsets[i, 0]
                    dy = b - y + offsets[j, 1] - offsets[i, 1]
                    dx = c - x + offsets[j, 2] - offsets[i, 2]
                    if dz * dz + dy * dy + dx * dx < distances[i] ** 2:
                        free = False
                        break
                if not free:
                    break
            if not free:
                break
        if free:
            taken[z, y, x] = i
            accepted[count] = i
            count += 1
    return accepted[:count]


def _blue_noise(
    occupied: Bool[np.ndarray, "z y x"],
    distance: Float[np.ndarray, "z y x"],
    first: Int[np.ndarray, " 3"],
    seed: int,
) -> Float[np.ndarray, "point 3"]:
    """Choose points (z, y, x) [voxels] in occupied voxels that keep their distance; the finest regions come first.

    The random numbers of a voxel belong to its place, `first` being that of voxel (0, 0, 0). Whether another voxel is
    occupied, which may depend on rounding, changes the points near that voxel and no others. Points are ordered by
    blocks, so that Gaussians which follow each other in memory cover the same voxels, which are then in the cache.
    """
    voxels = np.argwhere(occupied)
    numbers = random_of_places(voxels + first, seed)
    distances = distance[occupied]
    order = np.lexsort([numbers[:, 3], np.round(distances, 1)])  # equal tenths of a voxel in random order
    taken = np.full(occupied.shape, -1)
    voxels, offsets = voxels[order], numbers[order, :3] - 0.5
    kept = _throw_darts(voxels, offsets, distances[order], np.array(occupied.shape), taken)
    blocks = (voxels[kept] + first) // BLOCK
    kept = kept[np.lexsort((*voxels[kept].T[::-1], *blocks.T[::-1]))]
    return voxels[kept] + offsets[kept]


def places_of(grid: Grid) -> Int[np.ndarray, " 3"]:
    """Find the place (z, y, x) of a grid's first voxel among all voxels of this size, which a part of it shares.

    Parameters
    ----------
    grid : the grid

    Returns
    -------
    whole numbers along z, y, x
    """
    return np.floor(np.array(grid.origin) / np.array(grid.spacing) + 0.25).astype(np.int64)  # centres lie at halves


def random_of_places(places: Int[np.ndarray, "voxel 3"], seed: int) -> Float[np.ndarray, "voxel 4"]:
    """Compute four uniform random numbers in [0, 1) for each place.

    Parameters
    ----------
    places : whole numbers along z, y, x
    seed : of the numbers

    Returns
    -------
    four numbers per place

    References
    ----------
    The mixing function of SplitMix64: Steele, Lea & Flood 2014, doi:10.1145/2660193.2660195.
    """
    state = np.full(len(places), seed, np.uint64)
    for index in places.T.astype(np.uint64):
        state = _mixed(state + index * np.uint64(_GOLDEN))
    counted = state[:, None] + np.arange(1, 5, dtype=np.uint64) * np.uint64(_GOLDEN)
    return (_mixed(counted) >> np.uint64(11)) * 2.0**-53


def _mixed(state: UInt64[np.ndarray, "..."]) -> UInt64[np.ndarray, "..."]:
    """Mix the bits of 64-bit states, as SplitMix64 does."""
    state = (state ^ (state >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    state = (state ^ (state >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return state ^ (state >> np.uint64(31))


def neighbour_distance(
    points: Float[np.ndarray, "point 3"], nearest: int, default: float
) -> Float[np.ndarray, " point"]:
    """Compute the root mean square distance to the nearest points [mm]; `default` where there is one point alone.

    Parameters
    ----------
    points : places [mm]
    nearest : number of neighbours that are meant
    default : distance of a point that is alone [mm]

    Returns
    -------
    distances [mm]
    """
    neighbours = min(nearest, len(points) - 1)
    if neighbours == 0:
        return np.full(len(points), default)
    distances = KDTree(points).query(points, k=neighbours + 1, workers=thread_count())[0][:, 1:]
    return np.sqrt((distances**2).mean(axis=1))
