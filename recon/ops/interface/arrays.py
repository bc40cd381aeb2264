"""The arrays that describe divided Gaussians, and those that kernels take and write together."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float32, Float64, Int64
from torch import Tensor


class DividedTensors(NamedTuple):
    """Gaussians that are each divided by a plane.

    Parameters
    ----------
    centres : positions (x, y, z) [mm]
    log_scales : logarithms of the standard deviations along the principal axes [log mm]
    quaternions : orientations (w, x, y, z), of any length [no unit]
    planes : offset of the plane from the centre along the third axis, and width of the transition across it, both in
        standard deviations of the third axis
    below, above : coefficients on the negative and on the positive side of the plane [1/mm]
    """

    centres: Float[Tensor, "gaussian 3"]
    log_scales: Float[Tensor, "gaussian 3"]
    quaternions: Float[Tensor, "gaussian 4"]
    planes: Float[Tensor, "gaussian 2"]
    below: Float[Tensor, "gaussian basis"]
    above: Float[Tensor, "gaussian basis"]

    def exact(self) -> "DividedTensors":
        """Convert all arrays to float64.

        Returns
        -------
        the same Gaussians
        """
        return DividedTensors(*(part.double() for part in self))


class Shapes(NamedTuple):
    """Where Gaussians lie, as kernels read it.

    Parameters
    ----------
    centres : positions [mm]
    log_scales : logarithms of the standard deviations [log mm]
    matrices : whitening matrices [1/mm]
    planes : offset of each plane and width of its transition [standard deviations of the third axis]
    """

    centres: Float64[np.ndarray, "gaussian 3"]
    log_scales: Float64[np.ndarray, "gaussian 3"]
    matrices: Float64[np.ndarray, "gaussian 3 3"]
    planes: Float64[np.ndarray, "gaussian 2"]


class ShapeGradients(NamedTuple):
    """Gradients in the fields of `Shapes` but for the scales.

    Parameters
    ----------
    centres, matrices, planes : gradients
    """

    centres: Float64[np.ndarray, "gaussian 3"]
    matrices: Float64[np.ndarray, "gaussian 3 3"]
    planes: Float64[np.ndarray, "gaussian 2"]


class Sides(NamedTuple):
    """Coefficients of both sides.

    Parameters
    ----------
    below : below the planes [1/mm]
    step : above the planes less those below [1/mm]
    """

    below: Float32[np.ndarray, "gaussian basis"]
    step: Float32[np.ndarray, "gaussian basis"]


class SideGradients(NamedTuple):
    """What the backward pass over pixels or voxels leaves.

    Parameters
    ----------
    sums : over the pixels or voxels of each Gaussian
    below, step : gradients in the coefficients
    """

    sums: Float64[np.ndarray, "gaussian sum"]
    below: Float64[np.ndarray, "gaussian basis"]
    step: Float64[np.ndarray, "gaussian basis"]


class Footprints(NamedTuple):
    """Footprints of all Gaussians in one view.

    Parameters
    ----------
    table : their numbers, see `recon.ops.interface.table`
    spans : first row of each footprint, and one past its last; equal where there is none
    """

    table: Float32[np.ndarray, "gaussian number"]
    spans: Int64[np.ndarray, "gaussian 2"]


class VoxelNumbers(NamedTuple):
    """Numbers of all Gaussians on a grid.

    Parameters
    ----------
    table : see `recon.ops.interface.voxel_table`
    voxels : those that the centres lie in
    halves : half the extent along z and y [voxels]
    """

    table: Float32[np.ndarray, "gaussian number"]
    voxels: Int64[np.ndarray, "gaussian 3"]
    halves: Float32[np.ndarray, "gaussian 2"]
