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
from typing import ClassVar

import numpy as np
from jaxtyping import Float
from torch import Tensor

from phantomgen.geometry.voxel_grid import Grid
from recon.data.measurements import Measurements, matching_bin
from recon.published_methods.neural.networks import Attenuation
from recon.published_methods.neural.rays import RayNumbers, Rays
from recon.published_methods.neural.training import PerceptronField, attenuation_units
from recon.published_methods.polychromatic_logs import PolychromaticLogs, coefficients_on
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
        logs_of = PolychromaticLogs(data)

        def project(
            values: Attenuation, steps: Float[Tensor, "ray 1"], numbers: RayNumbers
        ) -> Float[Tensor, "ray channel"]:
            return logs_of(coefficients_on(curve, values[..., 0]).sum(dim=1) * steps, numbers)

        return self._train(field, rays, grid, on_iteration, project, lambda values: curve.values(values[0]))
