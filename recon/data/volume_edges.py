"""Where volumes hold something, where their edges are, and how dense they are.

Structure is measured in units of noise, on volumes whitened by the mean Fisher matrix, so that the choice of bases
does not matter.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import gaussian_filter, maximum_filter

SMOOTHING = 0.7  # voxels; standard deviation of the Gaussian that tames noise before edges are looked for
BACKGROUND = 0.1  # a voxel below this fraction of a large signal is empty
LARGEST = 3.0  # times the typical signal; where metal is larger, that counts as large
METAL = 3.0  # times the typical density; what is denser counts as metal
EDGE = 4.0  # a gradient this many times the median, which is noise where most of an object is even, is an edge
CONTRAST = 0.1  # of the typical signal; a gradient per voxel of as much is an edge, whatever the median
_FAINT = 0.02  # for the typical value, see there


@dataclass(frozen=True, eq=False)
class VolumeEdges:
    """Of volumes.

    Parameters
    ----------
    occupied : voxels that hold something
    tensor : sum over bases of the products of gradients, in the order xx, yy, zz, xy, xz, yz
    strength : length of the gradient over that of an edge; 1 and more is an edge
    """

    occupied: Bool[np.ndarray, "z y x"]
    tensor: Float[np.ndarray, "pair z y x"]
    strength: Float[np.ndarray, "z y x"]

    @classmethod
    def of(cls, volumes: Float[np.ndarray, "basis z y x"], fisher: Float[np.ndarray, "basis basis"]) -> "VolumeEdges":
        """Find the edges of volumes.

        Parameters
        ----------
        volumes : of each basis [1/mm]
        fisher : mean Fisher matrix of the rays' line integrals
        """
        smooth = np.einsum("nm,mzyx->nzyx", np.linalg.cholesky(fisher).T, volumes)
        smooth = np.stack([gaussian_filter(w, SMOOTHING) for w in smooth])
        signal = np.sqrt((smooth**2).sum(axis=0))
        occupied = signal > BACKGROUND * min(np.percentile(signal, 99), LARGEST * _typical(signal))
        occupied = occupied if occupied.any() else np.ones_like(occupied)
        tensor = _products_of_gradients(smooth)
        gradient = np.sqrt(tensor[:3].sum(axis=0))
        least = min(EDGE * np.median(gradient[occupied]), CONTRAST * _typical(signal))
        return cls(occupied, tensor, gradient / max(least, 1e-30))


def _products_of_gradients(volumes: Float[np.ndarray, "basis z y x"]) -> Float[np.ndarray, "pair z y x"]:
    out = np.zeros((6, *volumes.shape[1:]), np.float32)
    for volume in volumes:
        z, y, x = _gradient(volume)
        for i, product in enumerate((x * x, y * y, z * z, x * y, x * z, y * z)):
            out[i] += product
    return out


def _gradient(volume: Float[np.ndarray, "z y x"]) -> list[Float[np.ndarray, "z y x"]]:
    """Change per voxel along each axis; none along an axis of one voxel."""
    return [np.gradient(volume, axis=i) if n > 1 else np.zeros_like(volume) for i, n in enumerate(volume.shape)]


def relative_density(volumes: Float[np.ndarray, "basis z y x"]) -> Float[np.ndarray, "z y x"]:
    """Sum of the coefficients of each voxel over that of a typical one that holds something; 1 where none does."""
    density = volumes.sum(axis=0)
    typical = _typical(density)
    return density / typical if typical > 0 else np.ones_like(density)


def over_metal(volumes: Float[np.ndarray, "basis z y x"]) -> Float[np.ndarray, "z y x"]:
    """Density over that of the least dense metal, at least 1; of a voxel and its neighbours, the largest."""
    over = np.maximum(relative_density(volumes) / METAL, 1)
    return maximum_filter(over, size=3) if over.max(initial=1) > 1 else over


def metal_without_agents(
    volumes: Float[np.ndarray, "basis z y x"], names: tuple[str, ...]
) -> tuple[Bool[np.ndarray, " basis"], Float[np.ndarray, "z y x"]]:
    """Which bases are K edges, and `over_metal` of what all others hold; of K edges alone, nothing is metal.

    A contrast agent makes its own basis large, and metal those of all matter.
    """
    edges = np.array([name.startswith("kedge") for name in names])
    if not edges.any() or edges.all():
        return edges, np.ones_like(volumes[0])
    return edges, over_metal(volumes[~edges])


def _typical(values: Float[np.ndarray, "z y x"]) -> float:
    """Median of what is there, however much is empty and however dense a part is; 0 where all is empty.

    There is what exceeds a small part of the value that half of the sum of all lies below.
    """
    ordered = np.sort(np.maximum(values, 0), axis=None)
    below = np.cumsum(ordered, dtype=np.float64)
    middle = ordered[np.searchsorted(below, below[-1] / 2)]
    there = ordered[np.searchsorted(ordered, _FAINT * middle) :]
    return float(there[(len(there) - 1) // 2] + there[len(there) // 2]) / 2 if middle > 0 else 0.0
