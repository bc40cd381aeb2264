"""Materials from the values of the volumes: at the centres of Gaussians, or in voxels."""

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float, Int, Integer
from scipy.sparse.csgraph import connected_components

from recon.readouts.mechanisms import Mechanisms
from recon.segmentation.clustering import find_modes, is_tail, nearest_mode, unit_of
from recon.segmentation.features import air_density, at_points, features_of, flat_inside, noise_of, voxel_places
from recon.segmentation.labelling import label_edges, nearest_voxels, ordered, rims
from recon.segmentation.result import Options
from recon.segmentation.subject import Subject
from recon.segmentation.thin_materials import with_thin_materials
from spectra.errors import InputError


@dataclass(frozen=True, eq=False)
class Found:
    """Materials in order.

    Parameters
    ----------
    labels : labels of all voxels: 0 air, i + 1 material i
    centres : medians of the mechanisms inside of each material [1/mm]
    coefficients : medians of the basis functions inside of each material [1/mm]
    """

    labels: Integer[np.ndarray, "z y x"]
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
    mechanisms : conversion of coefficients to mechanisms and features
    parts : volumes as mechanisms, not negative [1/mm]
    subject : volumes and grid
    options : bandwidth and seed
    points : points at which samples are taken, (x, y, z) [mm]; None for all voxels

    Returns
    -------
    materials and labels

    Raises
    ------
    InputError
        When there is nothing but air.
    """
    features = features_of(mechanisms, parts)
    inside = flat_inside(parts, air_density(mechanisms))
    if not inside.any():
        raise InputError("there is nothing to segment: nothing in the volume is wider than two voxels and no air")
    voxels = features[:, inside].T
    samples = voxels if points is None else _samples_at(points, features, inside, subject)
    unit = unit_of(voxels, noise_of(features, inside))
    modes = find_modes(samples if len(samples) else voxels, unit, options.bandwidth, options.seed)
    inner = np.zeros(inside.shape, np.uint16)
    groups = _groups(modes, unit, features, inside, options.bandwidth)
    inner[inside] = groups[nearest_mode(voxels, modes, unit)]
    inner = _renumbered(inner, np.flatnonzero(~rims(inner, len(modes)) & _present(inner, len(modes))))
    air = features[0] <= air_density(mechanisms)
    inner = with_thin_materials(inner, parts, features, air, medians(parts, inner), options.seed)
    centres = medians(parts, inner)
    order = ordered(features_of(mechanisms, centres.T).T)
    inner, centres, coefficients = _renumbered(inner, order), centres[order], medians(subject.volumes, inner)[order]
    return Found(label_edges(inner, parts, air, centres), centres, coefficients)


def medians(
    volumes: Float[np.ndarray, "component ..."], labels: Integer[np.ndarray, "..."]
) -> Float[np.ndarray, "label component"]:
    """Compute the median under each label except 0.

    Parameters
    ----------
    volumes : coefficients [1/mm]
    labels : labels of the voxels

    Returns
    -------
    medians of labels 1, 2, ... [1/mm]
    """
    return np.array([np.median(volumes[:, labels == i], axis=1) for i in range(1, int(labels.max()) + 1)])


def _samples_at(
    points: Float[np.ndarray, "point 3"], features: np.ndarray, inside: Bool[np.ndarray, "z y x"], subject: Subject
) -> Float[np.ndarray, "sample feature"]:
    """Features at the points that lie inside of a material."""
    index = nearest_voxels(voxel_places(subject.grid, points), inside.shape)
    return at_points(features, subject.grid, points[inside[index]]).T


def _groups(
    modes: Float[np.ndarray, "mode feature"],
    unit: Float[np.ndarray, " feature"],
    features: Float[np.ndarray, "feature z y x"],
    inside: Bool[np.ndarray, "z y x"],
    bandwidth: float,
) -> Int[np.ndarray, " mode"]:
    """Label of each mode: modes that noise can have separated share one, and modes that are tails of others have 0.

    The noise of ratios is larger the less dense a material is, so that one noise for all gives several modes in a lung.
    Here the noise is that of either mode, from voxels of its density. A few samples of a long tail can be a mode, too:
    all voxels decide whether a mode is a tail, and voxels of a tail are labelled as edges are.
    """
    near = [inside & (np.abs(features[0] - mode[0]) < bandwidth * unit[0]) for mode in modes]
    noise = np.maximum([[unit[0], *noise_of(features, here)[1:]] for here in near], unit)
    values, one = features[:, inside].T, np.eye(len(modes), dtype=bool)
    tail = np.zeros(len(modes), dtype=bool)
    for i, j in combinations(range(len(modes)), 2):
        scale = np.maximum(noise[i], noise[j])
        one[i, j] = np.linalg.norm((modes[i] - modes[j]) / scale) < bandwidth
        if not one[i, j] and not tail[j]:
            tail[j] = is_tail(values / scale, modes[i] / scale, modes[j] / scale)
    return np.where(tail, 0, 1 + connected_components(one)[1])


def _present(inner: Integer[np.ndarray, "z y x"], count: int) -> Bool[np.ndarray, " cluster"]:
    """True for clusters that have a voxel."""
    return np.bincount(inner.ravel(), minlength=count + 1)[1:] > 0


def _renumbered(inner: Integer[np.ndarray, "z y x"], kept: Int[np.ndarray, " cluster"]) -> Integer[np.ndarray, "z y x"]:
    """Labels after clusters were removed or sorted: cluster ``kept[i]`` becomes cluster i; others become 0."""
    table = np.zeros(int(max(inner.max(), kept.max() + 1)) + 1, np.uint16)
    table[1 + kept] = np.arange(1, len(kept) + 1)
    return table[inner]
