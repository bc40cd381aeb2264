"""Where volumes are occupied, where their edges lie, and how dense they are.

Structure is measured in units of noise, on volumes whitened by the mean Fisher matrix, so that the choice of bases
does not matter.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import gaussian_filter, maximum_filter

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
        occupied = signal > BACKGROUND * large_signal(signal)
        occupied = occupied if occupied.any() else np.ones_like(occupied)
        tensor = _products_of_gradients(smooth)
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
    the 99th percentile, or `LARGEST` times the typical value where that is less
    """
    return float(min(np.percentile(signal, 99), LARGEST * _typical(signal)))


def _products_of_gradients(volumes: Float[np.ndarray, "basis z y x"]) -> Float[np.ndarray, "pair z y x"]:
    out = np.zeros((6, *volumes.shape[1:]), np.float32)
    for volume in volumes:
        z, y, x = _gradient(volume)
        for i, product in enumerate((x * x, y * y, z * z, x * y, x * z, y * z)):
            out[i] += product
    return out


def _gradient(volume: Float[np.ndarray, "z y x"]) -> list[Float[np.ndarray, "z y x"]]:
    """Change per voxel along each axis; 0 along an axis of one voxel."""
    return [np.gradient(volume, axis=i) if n > 1 else np.zeros_like(volume) for i, n in enumerate(volume.shape)]


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
    """Median of the occupied voxels, whatever part is empty or very dense; 0 where all is empty.

    Occupied are voxels above the part `_FAINT` of the value below which half of the sum of all values lies.
    """
    ordered = np.sort(np.maximum(values, 0), axis=None)
    below = np.cumsum(ordered, dtype=np.float64)
    middle = ordered[np.searchsorted(below, below[-1] / 2)]
    there = ordered[np.searchsorted(ordered, _FAINT * middle) :]
    return float(there[(len(there) - 1) // 2] + there[len(there) // 2]) / 2 if middle > 0 else 0.0
