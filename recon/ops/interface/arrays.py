"""The arrays that describe divided Gaussians."""

from typing import NamedTuple

from jaxtyping import Float
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
