"""Materials by the values of the volumes: at the centres of Gaussians, or in voxels."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from recon.segmentation.clustering import find_modes, nearest_mode, unit_of
from recon.segmentation.features import Mechanisms, at_points, flat_inside, noise_of, voxel_places
from recon.segmentation.labelling import label_edges, nearest_voxels, ordered, rims
from recon.segmentation.result import Options
from recon.segmentation.subject import Subject
from spectra.errors import InputError


@dataclass(frozen=True, eq=False)
class Found:
    """Materials in order.

    Parameters
    ----------
    labels : of all voxels, 0 air and i + 1 material i
    centres : medians of the mechanisms inside of each [1/mm]
    coefficients : the same of the basis functions [1/mm]
    """

    labels: Int[np.ndarray, "z y x"]
    centres: Float[np.ndarray, "cluster mechanism"]
    coefficients: Float[np.ndarray, "cluster basis"]


def find_materials(
    mechanisms: Mechanisms,
    parts: Float[np.ndarray, "mechanism z y x"],
    subject: Subject,
    options: Options,
    points: Float[np.ndarray, "point 3"] | None,
) -> Found:
    """Cluster the inside of materials, then label the edges between them.

    Parameters
    ----------
    parts : volumes as mechanisms, not negative [1/mm]
    points : where to take samples, (x, y, z) [mm]; None for all voxels

    Raises
    ------
    InputError
        When there is nothing but air.
    """
    features = mechanisms.features(parts)
    inside = flat_inside(parts, mechanisms.air)
    if not inside.any():
        raise InputError("there is nothing to segment: nothing in the volume is wider than two voxels and no air")
    voxels = features[:, inside].T
    samples = voxels if points is None else _samples_at(points, features, inside, subject)
    unit = unit_of(voxels, noise_of(features, inside))
    modes = find_modes(samples if len(samples) else voxels, unit, options.bandwidth, options.seed)
    inner = np.zeros(inside.shape, np.uint16)
    inner[inside] = 1 + nearest_mode(voxels, modes, unit)
    inner = _renumbered(inner, np.flatnonzero(~rims(inner, len(modes)) & _present(inner, len(modes))))
    labelled = inner[inside] > 0
    groups, count = inner[inside][labelled].astype(np.intp) - 1, int(inner.max())
    centres = medians(parts[:, inside].T[labelled], groups, count)
    order = ordered(mechanisms.features(centres.T).T)
    inner, centres = _renumbered(inner, order), centres[order]
    coefficients = medians(subject.volumes[:, inside].T[labelled], groups, count)[order]
    labels = label_edges(inner, parts, features[0] <= mechanisms.air, centres)
    return Found(labels, centres, coefficients)


def medians(
    values: Float[np.ndarray, "sample component"], groups: Int[np.ndarray, " sample"], count: int
) -> Float[np.ndarray, "group component"]:
    """Median of each group."""
    return np.array([np.median(values[groups == i], axis=0) for i in range(count)])


def _samples_at(
    points: Float[np.ndarray, "point 3"], features: np.ndarray, inside: Bool[np.ndarray, "z y x"], subject: Subject
) -> Float[np.ndarray, "sample feature"]:
    """Features at those points that lie inside of a material."""
    index = nearest_voxels(voxel_places(subject.grid, points), inside.shape)
    return at_points(features, subject.grid, points[inside[index]]).T


def _present(inner: Int[np.ndarray, "z y x"], count: int) -> Bool[np.ndarray, " cluster"]:
    return np.bincount(inner.ravel(), minlength=count + 1)[1:] > 0


def _renumbered(inner: Int[np.ndarray, "z y x"], kept: Int[np.ndarray, " cluster"]) -> Int[np.ndarray, "z y x"]:
    """Labels after clusters were left out or ordered: cluster ``kept[i]`` becomes i; others become 0."""
    table = np.zeros(int(max(inner.max(), kept.max() + 1)) + 1, np.uint16)
    table[1 + kept] = np.arange(1, len(kept) + 1)
    return table[inner]
