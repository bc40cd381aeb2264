"""Arguments that the kernels take together: named tuples, whose fields numba compiles like single arguments."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float32, Float64
from torch import Tensor

from phantomgen.geometry.voxel_grid import Grid
from spectra.errors import InputError

LARGEST_EXPONENT = 60.0  # no unit; negative line integrals amplify by at most e^60, so that expected counts stay finite
TINY = 1e-300  # below all values that occur; replaces 0 in divisors and under square roots


class GaussianTensors(NamedTuple):
    """Gaussians as a fit has them, or ellipsoids, whose semi-axes take the place of standard deviations.

    Parameters
    ----------
    centres : centres [mm]
    log_scales : logarithm of the standard deviations along the principal axes [log mm]
    quaternions : orientation (w, x, y, z) of the principal axes; of any length but 0
    coefficients : value at the centre per basis [1/mm]
    """

    centres: Float[Tensor, "gaussian 3"]
    log_scales: Float[Tensor, "gaussian 3"]
    quaternions: Float[Tensor, "gaussian 4"]
    coefficients: Float[Tensor, "gaussian basis"]


class GaussianArrays(NamedTuple):
    """Gaussians as the kernels read them.

    Parameters
    ----------
    centres : centres p [mm]
    matrices : whitening matrices A = S^-1 R^T [1/mm], with S the standard deviations and R the rotation: |A (x - p)| is
        the distance of a point x from the centre in standard deviations
    coefficients : value at the centre per basis [1/mm]
    """

    centres: Float64[np.ndarray, "gaussian 3"]
    matrices: Float64[np.ndarray, "gaussian 3 3"]
    coefficients: Float32[np.ndarray, "gaussian basis"]


class GaussianGradients(NamedTuple):
    """Derivatives of a scalar in the arrays of `GaussianArrays`, which the kernels write or add to.

    Parameters
    ----------
    centres : derivatives in the centres
    matrices : derivatives in the whitening matrices
    coefficients : derivatives in the coefficients
    """

    centres: Float64[np.ndarray, "gaussian 3"]
    matrices: Float64[np.ndarray, "gaussian 3 3"]
    coefficients: Float64[np.ndarray, "gaussian basis"]


class TensorGradients(NamedTuple):
    """Derivatives of a scalar in the tensors of `GaussianTensors`.

    Parameters
    ----------
    centres, log_scales, quaternions, coefficients : derivatives in each of them
    """

    centres: Float64[np.ndarray, "gaussian 3"]
    log_scales: Float64[np.ndarray, "gaussian 3"]
    quaternions: Float64[np.ndarray, "gaussian 4"]
    coefficients: Float64[np.ndarray, "gaussian basis"]


class RayFrame(NamedTuple):
    """Rays of one view: that of pixel (x, y) runs along o + t (d0 + x du + y dv) from t = 0 to t = 1.

    Parameters
    ----------
    frame : source o, way d0 to the centre of the first pixel, column step du, row step dv [mm]
    inverse : inverse of the matrix with columns du, dv, d0 [1/mm]; times the offset of a point from the source it gives
        (x depth, y depth, depth), with (x, y) the pixel behind the point and depth the fraction of the way to the panel
    """

    frame: Float64[np.ndarray, "4 3"]
    inverse: Float64[np.ndarray, "3 3"]


class Lattice(NamedTuple):
    """Voxels of a grid.

    Parameters
    ----------
    origin : centre of the first voxel (x, y, z) [mm]
    spacing : distance between voxel centres (x, y, z) [mm]
    """

    origin: Float64[np.ndarray, "3"]
    spacing: Float64[np.ndarray, "3"]


class EnergyNodes(NamedTuple):
    """Energy nodes grouped by channel, as `spectra.transmission.Transmission` keeps them.

    Parameters
    ----------
    columns : functions of energy whose products with line integrals have no unit
    weights : photons times response of each node [counts]
    starts : channel c owns the nodes ``starts[c]`` to ``starts[c + 1]``
    """

    columns: Float64[np.ndarray, "column node"]
    weights: Float64[np.ndarray, " node"]
    starts: np.ndarray


def inverse_frames(frames: Float[np.ndarray, "view 4 3"]) -> Float64[np.ndarray, "view 3 3"]:
    """Compute the inverse matrix of `RayFrame` for every view.

    Parameters
    ----------
    frames : per view source, d0, column step and row step [mm]

    Returns
    -------
    inverse matrices [1/mm]
    """
    return np.linalg.inv(np.stack([frames[:, 2], frames[:, 3], frames[:, 1]], axis=-1))


def lattice_of(grid: Grid) -> Lattice:
    """Describe the voxels of a grid for the kernels.

    Parameters
    ----------
    grid : the grid

    Returns
    -------
    its voxels, axes in the order (x, y, z)
    """
    return Lattice(np.array(grid.origin[::-1], float), np.array(grid.spacing[::-1], float))


def check_shapes(operator: str, **parts: Tensor) -> None:
    """Check that tensors describe the same number of Gaussians.

    Parameters
    ----------
    operator : name of the operator, for the message
    **parts : centres, scales, quaternions and coefficients under the names that the operator gives them, in this order

    Raises
    ------
    InputError
        When the shape of a tensor does not belong to that of the first.
    """
    n = len(next(iter(parts.values())))
    for (name, value), width in zip(parts.items(), (3, 3, 4, None), strict=True):
        expected = (n, value.shape[-1] if width is None else width)
        if tuple(value.shape) != expected:
            raise InputError(f"{operator}: {name} has shape {tuple(value.shape)}, expected {expected}")
