"""Segmentation of a run into material maps; the truth is not read."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int, Integer
from scipy.ndimage import minimum_filter

from recon.gaussians.model import Gaussians
from recon.readouts.readouts import Readouts
from recon.segmentation.clustering import BANDWIDTH, find_modes, nearest_mode
from recon.segmentation.features import air_density, at_points, features_of, voxel_places
from recon.segmentation.labelling import NOTHING, label_at, label_edges, ordered
from recon.segmentation.local_values import find_materials, medians
from recon.segmentation.rendering import gaussian_materials
from recon.segmentation.result import DOMAINS, FEATURES, Options, Segmentation, describe
from recon.segmentation.subject import Subject
from spectra.errors import InputError
from spectra.threads import without_other_pools

_HALF = 0.5  # part of a voxel; voxels that materials fill less are not labelled by Gaussians
_CARRYING = 1e-3  # density of the densest Gaussian; Gaussians below it do not enter the mean shift; our choice


@without_other_pools()
def segment_subject(subject: Subject, options: Options) -> Segmentation:
    """Find the materials of a run.

    Parameters
    ----------
    subject : volumes, and Gaussians where there are any
    options : options of the segmentation

    Returns
    -------
    material maps

    Raises
    ------
    InputError
        When there are no Gaussians to segment, or nothing but air.
    """
    domain, model = options.domain or DOMAINS[subject.gaussians is None or subject.divided], subject.gaussians
    if domain == "gaussians" and model is None:
        raise InputError("a method on voxels has no Gaussians to segment: leave --domain out, or take voxels")
    if domain == "voxels" and options.features == "own":
        raise InputError("voxels have no coefficients of their own: the features of voxels are local")
    options = replace(options, domain=domain)
    readouts = Readouts.of(subject.basis, subject.energy, subject.weights)
    if model is not None and options.features == "own":
        coefficients, own = _by_own_coefficients(model, readouts, options)
        return _of_gaussians(subject, model, readouts, options, coefficients, own)
    parts = np.maximum(readouts.mechanisms(subject.volumes), 0.0)
    points = None if model is None or domain == "voxels" else model.centres.numpy().astype(np.float64)
    found = find_materials(readouts.mechanisms, parts, subject, options, points)
    if model is None or points is None:
        density = parts.sum(axis=0, dtype=np.float32)
        materials = np.stack([np.where(found.labels == i + 1, density, 0.0) for i in range(len(found.centres))])
        return _described(subject, readouts, options, found.coefficients, found.labels, materials)
    values = at_points(parts, subject.grid, points).T
    own = label_at(found.labels, voxel_places(subject.grid, points), values, found.centres).astype(np.intp) - 1
    return _of_gaussians(subject, model, readouts, options, found.coefficients, own)


def _by_own_coefficients(
    model: Gaussians, readouts: Readouts, options: Options
) -> tuple[Float[np.ndarray, "cluster basis"], Int[np.ndarray, " gaussian"]]:
    """Coefficients and labels as in the paper: by the coefficients of each Gaussian, over their standard deviation."""
    values, mechanisms = model.coefficients.numpy().astype(np.float64), readouts.mechanisms
    features = features_of(mechanisms, mechanisms(values.T)).T
    carrying = features[:, 0] > _CARRYING * features[:, 0].max()
    unit = np.maximum(features[carrying].std(axis=0), 1e-12) / BANDWIDTH
    modes = find_modes(features[carrying], unit, options.bandwidth, options.seed)
    nearest = np.unique(nearest_mode(features, modes, unit), return_inverse=True)[1]
    coefficients = medians(values.T, nearest + 1)
    order = ordered(features_of(mechanisms, mechanisms(coefficients.T)).T)
    return coefficients[order], np.argsort(order)[nearest]


def _of_gaussians(
    subject: Subject,
    model: Gaussians,
    readouts: Readouts,
    options: Options,
    coefficients: Float[np.ndarray, "cluster basis"],
    own: Int[np.ndarray, " gaussian"],
) -> Segmentation:
    """Segmentation from labelled Gaussians: a voxel gets the label of the material that fills most of it.

    A voxel that no material fills, whose 26 neighbours are not air, gets the label of the nearest coefficients, as at
    edges: a voxel with a little of a dense material is not air.
    """
    amounts, materials = gaussian_materials(model, own, len(coefficients), subject.grid)
    if options.features == FEATURES[1]:
        coefficients = _inside_of(materials, subject, readouts, coefficients)
    centres = np.maximum(readouts.mechanisms(coefficients.T), 0.0).T
    parts = materials / np.maximum(centres.sum(axis=1), 1e-12)[:, None, None, None]
    labels = np.where(parts.sum(axis=0) > _HALF, parts.argmax(axis=0) + 1, 0).astype(np.uint16)
    air = materials.sum(axis=0) <= air_density(readouts.mechanisms)
    unfilled = (labels == NOTHING) & minimum_filter(~air, 3)
    if unfilled.any():
        values = np.maximum(readouts.mechanisms(subject.volumes), 0.0)
        labels[unfilled] = label_edges(labels, values, air, centres)[unfilled]
    found = _described(subject, readouts, options, coefficients, labels, materials)
    return replace(found, gaussian_labels=own, gaussian_densities=amounts)


def _inside_of(
    materials: Float[np.ndarray, "material z y x"],
    subject: Subject,
    readouts: Readouts,
    own: Float[np.ndarray, "cluster basis"],
) -> Float[np.ndarray, "cluster basis"]:
    """Medians of the volumes where a material is the densest, in place of the coefficients of single Gaussians."""
    groups = np.where(materials.sum(axis=0) > air_density(readouts.mechanisms), materials.argmax(axis=0), len(own))
    present = [groups == i for i in range(len(own))]
    rows = [np.median(subject.volumes[:, m], axis=1) if m.any() else row for m, row in zip(present, own, strict=True)]
    return np.array(rows)


def _described(
    subject: Subject,
    readouts: Readouts,
    options: Options,
    coefficients: Float[np.ndarray, "cluster basis"],
    labels: Integer[np.ndarray, "z y x"],
    materials: Float[np.ndarray, "material z y x"],
) -> Segmentation:
    """Clusters with names, colours and physical numbers."""
    voxels = np.bincount(labels.ravel(), minlength=len(coefficients) + 1)[1:]
    clusters = describe(readouts, coefficients, options.energies, voxels * subject.grid.voxel_volume / 1000)
    return Segmentation(subject, readouts, options, clusters, labels, materials)
