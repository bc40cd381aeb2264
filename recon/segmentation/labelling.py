"""Labels of voxels and points, at edges too.

A voxel at an edge holds a mixture, and mixtures of two materials may look like a third one: half contrast agent and
half tissue is a weaker contrast agent. Therefore only the inside of materials is labelled by features. A voxel at an
edge gets the label of one of the materials whose inside is near: the one whose coefficients are nearest, as mixtures
lie on straight lines between coefficients. A voxel that no mixture of two of them explains gets the label of the
nearest material of all, so that thin walls are kept; thin structures that look like a mixture get the label of their
surroundings.
"""

import numpy as np
from jaxtyping import Bool, Float, Int, Integer
from scipy import ndimage

from recon.segmentation.features import SIGNIFICANT

REACH = 3  # voxels; distance from a voxel to materials whose label it may get; our choice
NOTHING = 0  # label of air; cluster i has the label i + 1
UNMIXED = 0.1  # parts of the largest coefficients; least distance to all mixtures of near materials to be none of them
DENSER = 1.5  # no unit; density over that of its label above which a point is another material; our choice
RIM = 0.9  # part of a cluster's voxels that touch other clusters above which it is a rim between them; our choice


def rims(inner: Integer[np.ndarray, "z y x"], count: int) -> Bool[np.ndarray, " cluster"]:
    """Find clusters that are soft edges between two materials of nearly equal coefficients, and no material.

    Parameters
    ----------
    inner : labels inside of materials, 0 elsewhere
    count : number of clusters

    Returns
    -------
    True for clusters of which more than `RIM` of the voxels touch other clusters; never for the largest cluster
    """
    lowest = np.where(inner == NOTHING, np.iinfo(inner.dtype).max, inner)
    touching = (ndimage.maximum_filter(inner, 3) != inner) | (ndimage.minimum_filter(lowest, 3) != inner)
    sizes = np.bincount(inner.ravel(), minlength=count + 1)[1:]
    parts = np.bincount(inner[touching], minlength=count + 1)[1:] / np.maximum(sizes, 1)
    found = parts > RIM
    found[sizes.argmax()] = False
    return found


def label_edges(
    inner: Integer[np.ndarray, "z y x"],
    parts: Float[np.ndarray, "mechanism z y x"],
    air: Bool[np.ndarray, "z y x"],
    centres: Float[np.ndarray, "cluster mechanism"],
) -> Integer[np.ndarray, "z y x"]:
    """Label the voxels at edges.

    Parameters
    ----------
    inner : labels inside of materials, 0 elsewhere
    parts : coefficients of mechanisms [1/mm]
    air : True for voxels of air
    centres : coefficients of mechanisms of the clusters [1/mm]

    Returns
    -------
    labels of all voxels
    """
    labels = inner.copy()
    open_voxels = (inner == NOTHING) & _near(~air)
    scale = np.maximum(centres.max(axis=0), 1e-12)
    values = parts[:, open_voxels].T / scale
    ends = np.concatenate([np.zeros_like(centres[:1]), centres]) / scale
    allowed = np.stack([_near(air if i == NOTHING else inner == i)[open_voxels] for i in range(len(ends))])
    distances = np.stack([np.linalg.norm(values - end, axis=1) for end in ends])
    free = distances.argmin(axis=0)
    best = np.where(allowed.any(axis=0), np.where(allowed, distances, np.inf).argmin(axis=0), free)
    doubtful = np.flatnonzero(best != free)
    mixed = _off_allowed_mixtures(values[doubtful], ends, allowed[:, doubtful])
    other = (mixed > UNMIXED) & (distances[free[doubtful], doubtful] < mixed / 2)
    best[doubtful[other]] = free[doubtful[other]]
    labels[open_voxels] = best
    return labels


def _off_allowed_mixtures(
    values: Float[np.ndarray, "point mechanism"],
    ends: Float[np.ndarray, "label mechanism"],
    allowed: Bool[np.ndarray, "label point"],
) -> Float[np.ndarray, " point"]:
    """Distance of each point to the nearest mixture of two of its allowed labels."""
    least = np.full(len(values), np.inf)
    for i, first in enumerate(ends):
        for j in range(i + 1, len(ends)):
            distance = off_mixtures(values, first, ends[j])
            least = np.where(allowed[i] & allowed[j], np.minimum(least, distance), least)
    return least


def off_mixtures(
    values: Float[np.ndarray, "point mechanism"],
    first: Float[np.ndarray, " mechanism"],
    second: Float[np.ndarray, " mechanism"],
) -> Float[np.ndarray, " point"]:
    """Compute the distance of points to the mixtures of two materials, which lie on the line segment between them.

    Parameters
    ----------
    values : coefficients of the points
    first, second : coefficients of the two materials

    Returns
    -------
    distances, in the unit of the coefficients
    """
    along = second - first
    part = np.clip((values - first) @ along / max(along @ along, 1e-24), 0.0, 1.0)
    return np.linalg.norm(values - first - part[:, None] * along, axis=1)


def label_at(
    labels: Integer[np.ndarray, "z y x"],
    places: Float[np.ndarray, "3 point"],
    values: Float[np.ndarray, "point mechanism"],
    centres: Float[np.ndarray, "cluster mechanism"],
) -> Integer[np.ndarray, " point"]:
    """Label points by their voxels, or by their coefficients where the voxel is air or far less dense than the point.

    Parameters
    ----------
    labels : labels of all voxels
    places : positions of the points in voxels (z, y, x)
    values : coefficients of mechanisms at the points [1/mm]
    centres : coefficients of mechanisms of the clusters [1/mm]

    Returns
    -------
    labels of the points: those of the nearest clusters where the sum of coefficients is above `DENSER` times the
    density of the voxel's label, which is 0 for air
    """
    found = labels[nearest_voxels(places, labels.shape)]
    density = np.concatenate([[0.0], centres.sum(axis=1)])
    lost = values.sum(axis=1) > DENSER * density[found]
    scale = np.maximum(centres.max(axis=0), 1e-12)
    found[lost] = 1 + _nearest(values[lost], centres, scale)
    return found


def nearest_voxels(
    places: Float[np.ndarray, "3 point"], shape: tuple[int, ...]
) -> tuple[Int[np.ndarray, " point"], ...]:
    """Find the voxel of each point, or the nearest one for points outside of the grid.

    Parameters
    ----------
    places : positions of the points in voxels (z, y, x)
    shape : number of voxels (z, y, x)

    Returns
    -------
    indices of the voxels along z, y and x
    """
    return tuple(np.clip(np.rint(p).astype(np.intp), 0, n - 1) for p, n in zip(places, shape, strict=True))


def ordered(features: Float[np.ndarray, "cluster feature"]) -> Int[np.ndarray, " cluster"]:
    """Sort clusters: those without K edge by kappa and density, then those of each K edge by its part.

    Parameters
    ----------
    features : rho, kappa, f_K of each K edge

    Returns
    -------
    indices of the clusters in this order
    """
    parts = features[:, 2:]
    column = np.where((parts > SIGNIFICANT).any(axis=1), parts.argmax(axis=1) if parts.shape[1] else 0, -1)
    amount = np.where(column >= 0, parts.max(axis=1, initial=0.0), features[:, 1])
    return np.lexsort((features[:, 0], amount, column))


def _nearest(
    values: Float[np.ndarray, "point mechanism"],
    centres: Float[np.ndarray, "cluster mechanism"],
    scale: Float[np.ndarray, " mechanism"],
) -> Int[np.ndarray, " point"]:
    """Index of the nearest centre of each point, each mechanism relative to its scale."""
    distances = np.stack([np.square((values - centre) / scale).sum(axis=1) for centre in centres])
    return distances.argmin(axis=0)


def _near(mask: Bool[np.ndarray, "z y x"]) -> Bool[np.ndarray, "z y x"]:
    """Voxels within reach of a mask."""
    return ndimage.maximum_filter(mask.view(np.uint8), 2 * REACH + 1, mode="nearest").astype(bool)
