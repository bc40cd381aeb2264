"""Scores of material maps against the truth of a dataset: overlap and images. They do not influence a segmentation."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from jaxtyping import Float, Int, Integer
from scipy.optimize import linear_sum_assignment

from phantomgen.geometry.poses import Geometry
from recon.segmentation.rendering import gaussian_lengths, picture, voxel_lengths
from recon.segmentation.result import Cluster, Segmentation
from recon.segmentation.scoring.concentrations import regress
from recon.segmentation.scoring.image_similarity import image_similarity
from recon.segmentation.scoring.reference import Reference


def score(segmentation: Segmentation, reference: Reference) -> dict[str, Any]:
    """Compute all scores, for JSON.

    Parameters
    ----------
    segmentation : material maps
    reference : truth

    Returns
    -------
    ``materials`` by true material: the ``cluster`` matched to it, ``dice``, ``voxels``, and the true numbers;
    ``confusion``: voxels by true material and cluster; ``mean_dice`` of materials; ``rgb_views`` and ``rgb_slices``:
    see `recon.segmentation.scoring.image_similarity`; ``concentration`` by contrast agent: see
    `recon.segmentation.scoring.concentrations`
    """
    truth, count = reference.truth, len(segmentation.clusters)
    table = confusion(truth.labels, segmentation.labels, len(truth.material_names), count)
    matched = match(table)
    overlap = dice(table)
    rows = {}
    for i, (name, material) in enumerate(zip(truth.material_names, reference.materials, strict=True)):
        cluster = matched[i]
        rows[name] = {
            "cluster": None if cluster < 0 else segmentation.clusters[cluster].name,
            "dice": 0.0 if cluster < 0 else float(overlap[i + 1, cluster + 1]),
            "voxels": int(table[i + 1].sum()),
            "true": numbers_of(material),
        }
    present = [row["dice"] for row in rows.values() if row["voxels"]]
    colours = matched_colours(segmentation, reference, matched)
    return {
        "materials": rows,
        "mean_dice": float(np.mean(present)) if present else None,
        "confusion": {
            "rows": ["air", *truth.material_names],
            "columns": ["air", *(c.name for c in segmentation.clusters)],
            "voxels": table.tolist(),
        },
        "rgb_views": image_similarity(_view_pairs(segmentation, reference, colours)),
        "rgb_slices": image_similarity(_slice_pairs(segmentation, reference, colours)),
        "concentration": regress(segmentation, reference),
    }


def confusion(
    truth: Integer[np.ndarray, "*voxels"], found: Integer[np.ndarray, "*voxels"], materials: int, clusters: int
) -> Int[np.ndarray, "true found"]:
    """Count voxels by their true label and the label found.

    Parameters
    ----------
    truth, found : labels of all voxels; 0 is air
    materials : number of true materials
    clusters : number of clusters

    Returns
    -------
    numbers of voxels
    """
    pairs = truth.astype(np.int64).ravel() * (clusters + 1) + found.ravel()
    return np.bincount(pairs, minlength=(materials + 1) * (clusters + 1)).reshape(materials + 1, clusters + 1)


def dice(table: Int[np.ndarray, "true found"]) -> Float[np.ndarray, "true found"]:
    """Compute the Dice coefficient 2 |A and B| / (|A| + |B|) of every true material with every cluster.

    Parameters
    ----------
    table : numbers of voxels, see `confusion`

    Returns
    -------
    coefficients; 0 for two empty ones

    References
    ----------
    Dice 1945, doi:10.2307/1932409.
    """
    sizes = table.sum(axis=1)[:, None] + table.sum(axis=0)[None]
    return 2.0 * table / np.maximum(sizes, 1)


def match(table: Int[np.ndarray, "true found"]) -> Int[np.ndarray, " material"]:
    """Match a cluster to each material, by the assignment with the largest sum of Dice coefficients.

    Parameters
    ----------
    table : numbers of voxels, see `confusion`

    Returns
    -------
    cluster of each material; -1 where there is none
    """
    overlap = dice(table)[1:, 1:]
    matched = np.full(len(overlap), -1)
    rows, columns = linear_sum_assignment(-overlap)
    real = overlap[rows, columns] > 0
    matched[rows[real]] = columns[real]
    return matched


def matched_colours(
    segmentation: Segmentation, reference: Reference, matched: Int[np.ndarray, " material"]
) -> Float[np.ndarray, "cluster 3"]:
    """Return the colours of clusters, replaced by those of the true materials that they match.

    Parameters
    ----------
    segmentation : material maps
    reference : truth
    matched : cluster of each material, see `match`

    Returns
    -------
    RGB of each cluster, 0 to 1, with which images compare positions and not names
    """
    colours = segmentation.colours.copy()
    for material, cluster in enumerate(matched):
        if cluster >= 0:
            colours[cluster] = reference.colours[material]
    return colours


def numbers_of(cluster: Cluster) -> dict[str, Any]:
    """Collect the physical numbers of a cluster or a material, for JSON.

    Parameters
    ----------
    cluster : material

    Returns
    -------
    numbers by name; None for NaN
    """

    def known(value: float) -> float | None:
        return float(value) if np.isfinite(value) else None

    return {
        "coefficients": cluster.coefficients.tolist(),
        "volume_ml": cluster.volume_ml,
        "atomic_number": known(cluster.atomic_number),
        "electron_density": known(cluster.electron_density),
        "hounsfield": list(cluster.hounsfield),
        "without_contrast": list(cluster.without_contrast),
        "concentrations": cluster.concentrations,
    }


def _view_pairs(
    segmentation: Segmentation, reference: Reference, colours: np.ndarray
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Images of the views, and true ones."""
    volumes, grid = reference.volumes, reference.truth.grid
    for view in range(len(reference.geometry)):
        one = reference.geometry[[view]]
        found = lengths_of(segmentation, one)[0]
        true = voxel_lengths(volumes, grid, one)[0]
        yield picture(found, colours), picture(true, reference.colours)


def lengths_of(segmentation: Segmentation, geometry: Geometry) -> Float[np.ndarray, "view material row column"]:
    """Compute line integrals of the density of each cluster.

    Parameters
    ----------
    segmentation : material maps
    geometry : poses of the views

    Returns
    -------
    line integrals [no unit], of the Gaussians where they are labelled, else of the voxels
    """
    gaussians, amounts = segmentation.subject.gaussians, segmentation.gaussian_densities
    if gaussians is not None and amounts is not None:
        return gaussian_lengths(gaussians, amounts, geometry)
    return voxel_lengths(segmentation.materials, segmentation.subject.grid, geometry)


def _slice_pairs(
    segmentation: Segmentation, reference: Reference, colours: np.ndarray
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Images of the axial slices that hold materials, and true ones."""
    filled = np.flatnonzero(reference.truth.fractions.any(axis=(0, 2, 3)))
    return zip(segmentation.rgb(colours)[filled], reference.rgb()[filled], strict=True)
