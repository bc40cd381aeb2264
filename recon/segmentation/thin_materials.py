"""Materials that are nowhere thick: ribs, wires, walls of vessels, of which no voxel is inside.

Mixtures of two materials lie on the straight line between their coefficients. A voxel that lies on no such line between
known materials, or air, holds another material. Where enough such voxels are connected, their densest points are
clustered. Partial volume lowers the coefficients of thin structures: a cluster has the coefficients of its denser half.
"""

from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float, Integer
from scipy import ndimage

from recon.segmentation.clustering import find_modes, nearest_mode
from recon.segmentation.features import noise_in
from recon.segmentation.labelling import off_mixtures

UNLIKE = 0.3  # no unit; distance to all mixtures over a voxel's coefficients above which it is none; our choice
NOISE = 5.0  # standard deviations of noise; least distance to all mixtures of a voxel that is none; our choice
LEAST = 20  # voxels; fewest that are connected, and fewest density peaks of a material; our choice
PEAK = 0.9  # no unit; density over the largest of the 26 neighbours above which a voxel is a peak; our choice
# units of log(rho), kappa and each f_K in the mean shift, for the spread by partial volume; our choice
_UNITS = (0.13, 0.1, 0.05)


def with_thin_materials(
    inner: Integer[np.ndarray, "z y x"],
    parts: Float[np.ndarray, "mechanism z y x"],
    features: Float[np.ndarray, "feature z y x"],
    air: Bool[np.ndarray, "z y x"],
    centres: Float[np.ndarray, "cluster mechanism"],
    seed: int,
) -> Integer[np.ndarray, "z y x"]:
    """Add labels for the densest points of thin materials.

    Parameters
    ----------
    inner : labels inside of materials, 0 elsewhere
    parts : coefficients of mechanisms [1/mm]
    features : rho [1/mm], kappa and f_K
    air : True for voxels of air
    centres : coefficients of mechanisms of the clusters [1/mm]
    seed : seed of the choice of samples

    Returns
    -------
    labels inside of materials, with further labels for points of thin ones
    """
    noise = NOISE * float(np.linalg.norm([noise_in(p, inner > 0) for p in parts]))
    unlike = _unlike_mixtures(parts, (inner == 0) & ~air, centres, noise)
    peaks = unlike & (features[0] > PEAK * ndimage.maximum_filter(features[0], 3))
    if peaks.sum() < LEAST:
        return inner
    samples = features[:, peaks].T.astype(np.float64)
    samples[:, 0] = np.log(samples[:, 0])
    unit = np.array([*_UNITS[:2], *[_UNITS[2]] * (len(features) - 2)])
    modes = find_modes(samples, unit, seed=seed)
    nearest = nearest_mode(samples, modes, unit)
    out, label, chosen = inner.copy(), int(inner.max()), np.zeros(len(samples), np.uint16)
    for mode in range(len(modes)):
        members = np.flatnonzero(nearest == mode)
        if len(members) >= LEAST:
            label += 1
            chosen[members[samples[members, 0] >= np.median(samples[members, 0])]] = label
    out[peaks] = chosen
    return out


def _unlike_mixtures(
    parts: Float[np.ndarray, "mechanism z y x"],
    where: Bool[np.ndarray, "z y x"],
    centres: Float[np.ndarray, "cluster mechanism"],
    noise: float,
) -> Bool[np.ndarray, "z y x"]:
    """Voxels that no mixture of two clusters, or of one and air, explains, where enough of them are connected."""
    unlike, values = np.flatnonzero(where), parts[:, where].T
    limit = np.maximum(UNLIKE * np.linalg.norm(values, axis=1), noise)
    for first, second in combinations([np.zeros_like(centres[0]), *centres], 2):
        left = off_mixtures(values, first, second) > limit
        unlike, values, limit = unlike[left], values[left], limit[left]
    found = np.zeros(where.shape, bool)
    found.ravel()[unlike] = True
    pieces = np.zeros(where.shape, np.int32)
    ndimage.label(found, structure=np.ones((3, 3, 3)), output=pieces)
    large = np.bincount(pieces.ravel()) >= LEAST
    large[0] = False
    return large[pieces]
