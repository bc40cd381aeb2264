"""A coordinate network for one energy whose counts are polychromatic, after Polyner.

The network computes attenuation from position. Along a ray, what it computes becomes the counts of each channel through
the spectrum, and the logarithms of these are compared with the measured ones, so that neither beam hardening nor metal
has to be corrected or masked. Simplified: the network computes the attenuation at one energy, and a curve of materials
gives that at all others, where Polyner computes many energies, and a penalty makes most of them alike; grids of
features are dense, as in `recon.published_methods.neural.naf`. Kept: the mean absolute residual of logarithms.

References
----------
Wu, Chen, Wei, Yu, Zhang 2023, Unsupervised polychromatic neural representation for CT metal artifact reduction,
NeurIPS, arXiv:2306.15203.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from phantomgen.geometry.voxel_grid import Grid
from recon.data.measurements import Measurements, matching_bin
from recon.published_methods.neural.networks import Attenuation
from recon.published_methods.neural.rays import RayNumbers, Rays
from recon.published_methods.neural.training import PerceptronField, attenuation_units
from recon.voxel.image_domain import log_projections
from recon.voxel.method import OnIteration, Volumes, no_callback
from spectra.errors import InputError
from spectra.materials.material_curve import MaterialCurve
from spectra.threads import without_other_pools


@dataclass(frozen=True)
class Polyner(PerceptronField):
    """A grid of features, a perceptron, a curve of materials and the spectrum, as a `recon.voxel.method.CountsMethod`.

    Parameters
    ----------
    curve : materials of the object
    """

    curve: MaterialCurve | None = None

    power: ClassVar[float] = 1.0  # no unit; of the residuals, as in the article

    @property
    def name(self) -> str:
        """Name of the method for ``--method``."""
        return "polyner"

    @without_other_pools()
    def reconstruct_counts(
        self, measurements: Measurements, grid: Grid, on_iteration: OnIteration = no_callback
    ) -> Volumes:
        """Reconstruct volumes from counts.

        Parameters
        ----------
        measurements : views, unbinned
        grid : grid of the volume
        on_iteration : called every few steps, with the relative residual of the logarithms of the rays in between

        Returns
        -------
        volumes of the bases [1/mm]

        Raises
        ------
        InputError
            When there is no curve of materials.
        """
        if self.curve is None:
            raise InputError(f"the method {self.name} needs a curve of materials: add --bases curve")
        curve = self.curve
        data = measurements.completed().binned(matching_bin(measurements.geometry, min(grid.spacing)))
        logs = log_projections(data)
        seen = np.broadcast_to((data.gains > 0).any(axis=0), logs.shape[1:])
        rays = Rays(logs, seen.astype(np.float32), data.geometry, grid, self.seed)
        field = self._field(1, attenuation_units(logs[:1], grid), grid)
        project = PolychromaticRays(data, curve)
        return self._train(field, rays, grid, on_iteration, project, lambda values: curve.values(values[0]))


class PolychromaticRays:
    """Log projections of rays from the attenuation at one energy along them.

    Parameters
    ----------
    data : spectral model, and what makes the beam differ over the panel
    curve : materials of the object
    """

    def __init__(self, data: Measurements, curve: MaterialCurve) -> None:
        self.curve, model, bases = curve, data.transmission, len(data.basis_names)
        columns = torch.from_numpy(model.columns).float()
        self.columns, self.fixed_columns = columns[:bases], columns[bases:]
        self.log_weights = torch.from_numpy(model.weights).float().log()
        self.channels = [slice(a, b) for a, b in pairwise(model.starts.tolist())]
        rows, columns_of_panel = data.counts.shape[2:]
        parts = np.zeros((0, rows, columns_of_panel)) if data.profile is None else data.profile
        self.profile = torch.from_numpy(parts.reshape(len(parts), rows * columns_of_panel).T.copy()).float()

    def __call__(
        self, values: Attenuation, steps: Float[Tensor, "ray 1"], numbers: RayNumbers
    ) -> Float[Tensor, "ray channel"]:
        """Compute log projections, a `recon.published_methods.neural.training.Projection`.

        Parameters
        ----------
        values : attenuation at the energy of the curve at the points of each ray [1/mm]
        steps : length that each point represents [mm]
        numbers : numbers of the rays

        Returns
        -------
        logarithm of open beam over counts [no unit]
        """
        lengths = coefficients_on(self.curve, values[..., 0]).sum(dim=1) * steps
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
