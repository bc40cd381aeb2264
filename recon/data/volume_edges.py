"""Where volumes are occupied, where their edges lie, and how dense they are.

Structure is measured in units of noise, on volumes whitened by the mean Fisher matrix, so that the choice of bases
does not matter.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import gaussian_filter, maximum_filter, minimum_filter

SMOOTHING = 0.7  # voxels; standard deviation of the Gaussian that reduces noise before edges are found; by hand
BACKGROUND = 0.1  # no unit, over a large signal; a voxel below is empty; chosen by hand, not measured
# no unit, over the typical signal; a large signal is the 99th percentile, or this where metal exceeds it, so that the
# body beside steel does not count as empty (docs/development/decisions/0009-metal.md)
LARGEST = 3.0
METAL = 3.0  # no unit, over the typical density; denser voxels are metal; chosen by hand, not measured
# no unit, over the median gradient, which is noise where most of an object is homogeneous; larger gradients are edges;
# chosen by hand, not measured
EDGE = 4.0
# no unit, over the typical signal; larger gradients per voxel are edges whatever the median is; 0.3 loses 0.1 to 0.4 dB
# (docs/development/decisions/0015-where-gaussians-are-dense.md)
CONTRAST = 0.1
OCCUPIED = 0.02  # no unit, over a large value of a basis; a voxel that holds less of every basis is air; by hand
_FAINT = 0.02  # no unit; see `_typical`; chosen by hand, not measured


@dataclass(frozen=True, eq=False)
class VolumeEdges:
    """Occupied voxels and edges of volumes.

    Parameters
    ----------
    occupied : voxels that are not empty
    tensor : structure tensor, the sum over bases of the products of gradients, in the order xx, yy, zz, xy, xz, yz
    strength : length of the gradient over that of the weakest edge; 1 and more is an edge
    """

    occupied: Bool[np.ndarray, "z y x"]
    tensor: Float[np.ndarray, "pair z y x"]
    strength: Float[np.ndarray, "z y x"]

    @classmethod
    def of(cls, volumes: Float[np.ndarray, "basis z y x"], fisher: Float[np.ndarray, "basis basis"]) -> "VolumeEdges":
        """Find the edges of volumes.

        Parameters
        ----------
        volumes : coefficients of each basis [1/mm]
        fisher : mean Fisher matrix of the line integrals of rays

        Returns
        -------
        occupied voxels and edges
        """
        smooth = np.einsum("nm,mzyx->nzyx", np.linalg.cholesky(fisher).T, volumes)
        smooth = np.stack([gaussian_filter(w, SMOOTHING) for w in smooth])
        signal = np.sqrt((smooth**2).sum(axis=0))
        occupied = signal > BACKGROUND * min(np.percentile(signal, 99), LARGEST * _typical(signal))
        occupied = occupied if occupied.any() else np.ones_like(occupied)
        tensor = structure_tensor([gradient_of(volume) for volume in smooth])
        gradient = np.sqrt(tensor[:3].sum(axis=0))
        least = min(EDGE * np.median(gradient[occupied]), CONTRAST * _typical(signal))
        return cls(occupied, tensor, gradient / max(least, 1e-30))


def large_signal(signal: Float[np.ndarray, "z y x"]) -> float:
    """Find a large value of a signal, whatever part of the volume is empty, and without metal or a few wrong voxels.

    Parameters
    ----------
    signal : not negative

    Returns
    -------
    the 99th percentile of the occupied voxels, or `LARGEST` times the typical value where that is less; 0 where all is
    empty
    """
    occupied = _occupied_values(signal)
    return float(min(np.percentile(occupied, 99), LARGEST * np.median(occupied))) if len(occupied) else 0.0


def occupied_voxels(volumes: Float[np.ndarray, "basis z y x"]) -> Bool[np.ndarray, "z y x"]:
    """Find the voxels that are not air, whatever metal the object holds.

    Parameters
    ----------
    volumes : coefficients of each basis [1/mm]

    Returns
    -------
    True where a basis exceeds `OCCUPIED` of its large values
    """
    large = np.array([large_signal(volume) for volume in volumes])
    return np.any(volumes > OCCUPIED * large[:, None, None, None], axis=0)


def structure_tensor(gradients: Sequence[Sequence[Float[np.ndarray, "z y x"]]]) -> Float[np.ndarray, "pair z y x"]:
    """Compute the structure tensor of volumes.

    Parameters
    ----------
    gradients : of each volume, along z, y and x

    Returns
    -------
    sums over the volumes of the products of gradients, in the order xx, yy, zz, xy, xz, yz
    """
    out = np.zeros((6, *gradients[0][0].shape), np.float32)
    for z, y, x in gradients:
        for i, product in enumerate((x * x, y * y, z * z, x * y, x * z, y * z)):
            out[i] += product
    return out


def gradient_of(volume: Float[np.ndarray, "z y x"]) -> list[Float[np.ndarray, "z y x"]]:
    """Compute the gradient of a volume.

    Parameters
    ----------
    volume : its values

    Returns
    -------
    change per voxel along z, y and x; 0 along an axis of one voxel
    """
    return [np.gradient(volume, axis=i) if n > 1 else np.zeros_like(volume) for i, n in enumerate(volume.shape)]


def directions_across(
    tensor: Float[np.ndarray, "pair z y x"], index: tuple[Int[np.ndarray, " point"], ...]
) -> Float[np.ndarray, "point 3"]:
    """Find the directions in which volumes change most, from their structure tensor averaged around.

    Parameters
    ----------
    tensor : of `structure_tensor`
    index : voxels, along z, y and x

    Returns
    -------
    unit vectors (x, y, z), of either sign
    """
    xx, yy, zz, xy, xz, yz = (gaussian_filter(t, SMOOTHING)[index] for t in tensor)
    matrices = np.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], axis=-1).reshape(-1, 3, 3)
    return np.linalg.eigh(matrices)[1][:, :, 2]


def relative_density(volumes: Float[np.ndarray, "basis z y x"]) -> Float[np.ndarray, "z y x"]:
    """Compute the density of each voxel relative to a typical one.

    Parameters
    ----------
    volumes : coefficients of each basis [1/mm]

    Returns
    -------
    sum of the coefficients over its typical value among occupied voxels; 1 everywhere where all is empty
    """
    density = volumes.sum(axis=0)
    typical = _typical(density)
    return density / typical if typical > 0 else np.ones_like(density)


def contrast_around(volumes: Float[np.ndarray, "basis z y x"]) -> Float[np.ndarray, "z y x"]:
    """Compute the difference between the densest and the least dense of a voxel and its neighbours.

    Parameters
    ----------
    volumes : coefficients of each basis [1/mm]

    Returns
    -------
    difference of `relative_density`; 0 in an even region
    """
    density = relative_density(volumes)
    return maximum_filter(density, size=3) - minimum_filter(density, size=3)


def over_metal(volumes: Float[np.ndarray, "basis z y x"]) -> Float[np.ndarray, "z y x"]:
    """Compute the density relative to that of the least dense metal.

    Parameters
    ----------
    volumes : coefficients of each basis [1/mm]

    Returns
    -------
    largest ratio among a voxel and its neighbours, at least 1
    """
    over = np.maximum(relative_density(volumes) / METAL, 1)
    return maximum_filter(over, size=3) if over.max(initial=1) > 1 else over


def metal_without_agents(
    volumes: Float[np.ndarray, "basis z y x"], names: tuple[str, ...]
) -> tuple[Bool[np.ndarray, " basis"], Float[np.ndarray, "z y x"]]:
    """Find the K-edge bases, and metal by the density of all other bases.

    A contrast agent makes its own basis large, metal those that all matter has. With K-edge bases alone, nothing counts
    as metal.

    Parameters
    ----------
    volumes : coefficients of each basis [1/mm]
    names : names of the bases

    Returns
    -------
    mask of the K-edge bases; `over_metal` of the others
    """
    edges = np.array([name.startswith("kedge") for name in names])
    if not edges.any() or edges.all():
        return edges, np.ones_like(volumes[0])
    return edges, over_metal(volumes[~edges])


def _typical(values: Float[np.ndarray, "z y x"]) -> float:
    """Median of the occupied voxels, whatever part is empty or very dense; 0 where all is empty."""
    there = _occupied_values(values)
    return float(there[(len(there) - 1) // 2] + there[len(there) // 2]) / 2 if len(there) else 0.0


def _occupied_values(values: Float[np.ndarray, "z y x"]) -> Float[np.ndarray, " occupied"]:
    """Values in ascending order above the part `_FAINT` of that below which half of the sum of all values lies."""
    ordered = np.sort(np.maximum(values, 0), axis=None)
    below = np.cumsum(ordered, dtype=np.float64)
    middle = ordered[np.searchsorted(below, below[-1] / 2)]
    return ordered[np.searchsorted(ordered, _FAINT * middle) :] if middle > 0 else ordered[:0]
