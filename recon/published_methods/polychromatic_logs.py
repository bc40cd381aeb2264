"""Log projections of methods for one energy whose counts are polychromatic: from line integrals, with gradients."""

from itertools import pairwise

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from recon.data.measurements import Measurements
from spectra.materials.material_curve import MaterialCurve


class PolychromaticLogs:
    """Log projections of rays from line integrals of the bases.

    Parameters
    ----------
    data : spectral model, and what makes the beam differ over the panel
    """

    def __init__(self, data: Measurements) -> None:
        model, bases = data.transmission, len(data.basis_names)
        columns = torch.from_numpy(model.columns).float()
        self.columns, self.fixed_columns = columns[:bases], columns[bases:]
        self.log_weights = torch.from_numpy(model.weights).float().log()
        self.channels = [slice(a, b) for a, b in pairwise(model.starts.tolist())]
        rows, columns_of_panel = data.counts.shape[2:]
        parts = np.zeros((0, rows, columns_of_panel)) if data.profile is None else data.profile
        self.profile = torch.from_numpy(parts.reshape(len(parts), rows * columns_of_panel).T.copy()).float()

    def __call__(
        self, lengths: Float[Tensor, "ray basis"], numbers: Int[np.ndarray, " ray"]
    ) -> Float[Tensor, "ray channel"]:
        """Compute log projections.

        Parameters
        ----------
        lengths : line integrals of the bases [no unit]
        numbers : numbers of the rays, counted over views, rows and columns

        Returns
        -------
        logarithm of open beam over counts [no unit], differentiable in the line integrals
        """
        fixed = self.profile[torch.from_numpy(numbers % len(self.profile))] @ self.fixed_columns
        open_beam = self.log_weights - fixed
        beam = open_beam - lengths @ self.columns
        logs = [open_beam[:, own].logsumexp(dim=1) - beam[:, own].logsumexp(dim=1) for own in self.channels]
        return torch.stack(logs, dim=1)


def coefficients_on(curve: MaterialCurve, attenuation: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape basis"]:
    """Compute basis coefficients on a curve, as `MaterialCurve.values` does, with gradients.

    Parameters
    ----------
    curve : materials
    attenuation : at its energy, not negative [1/mm]

    Returns
    -------
    coefficients [1/mm]
    """
    nodes = torch.tensor((0.0, *curve.attenuations))
    rows = torch.cat([torch.zeros(1, len(curve.coefficients[0])), torch.tensor(curve.coefficients)])
    slopes = rows.diff(dim=0) / nodes.diff()[:, None]
    segment = torch.bucketize(attenuation.detach(), nodes[1:-1], right=True)
    return rows[segment] + slopes[segment] * (attenuation - nodes[segment])[..., None]
