"""Gaussians for one energy whose counts are polychromatic, after the splat-based reduction of metal artefacts.

Each Gaussian has a density and one number that says which material it is. Its coefficients go through the spectrum, and
the logarithm of the counts is compared with the measured one: no metal is masked. The articles were not at hand, only
their summaries. Simplified or chosen by us: the material moves along straight lines between the mixtures of a curve of
materials, where the second article has a Bezier curve; the spectrum is that of the scan, where the first one fits it;
start, footprints, density control and loss are those of R2-Gaussian in the form of `GaussianMono`.

References
----------
Choi, Kim, Cho, Cho, Kim 2026, Splat-based metal artifact reduction in cone-beam CT via polychromatic modeling,
Eurographics; Choi, Cho, Kim, Kim 2026, Splat-based metal artifact reduction in cone-beam CT via compact attenuation
modeling, CVPR.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from recon.data.measurements import Measurements
from recon.ops.voxelize import voxelize
from recon.published_methods.paper.initialize import first_gaussians, units_of
from recon.published_methods.paper.model import FactorisedGaussians, Units
from recon.published_methods.paper.projections import line_integrals
from recon.published_methods.polychromatic_logs import PolychromaticLogs
from recon.published_methods.splatting.primitives import Attenuation, Image
from recon.published_methods.splatting.training import Splatting, Training, train
from recon.voxel.image_domain import log_projections
from recon.voxel.method import Iteration, OnIteration, Volumes, no_callback
from recon.voxel.one_channel.water_correction import filtered, known, lines_of_water
from spectra.errors import InputError
from spectra.materials.material_curve import MaterialCurve
from spectra.threads import without_other_pools

INSIDE = 1e-3  # no unit; distance of a first place on the curve from its ends, where a sigmoid has no slope


class Polychromatic(Attenuation):
    """Gaussians with a density at the energy of a curve, and a place on the curve.

    The place is a sigmoid of the model's only fraction, from the first material, 0, to the last, 1.

    Parameters
    ----------
    curve : materials of the object
    data : spectral model, and what makes the beam differ over the panel
    """

    def __init__(self, curve: MaterialCurve, data: Measurements) -> None:
        self.logs_of, self.curve = PolychromaticLogs(data), curve
        mixtures = np.array(curve.coefficients) / np.array(curve.attenuations)[:, None]
        self.mixtures = torch.from_numpy(np.concatenate([mixtures, mixtures[-1:]])).float()

    def coefficients(self, model: FactorisedGaussians, units: Units) -> Float[Tensor, "gaussian basis"]:
        """Compute the coefficients of the bases.

        Parameters
        ----------
        model : Gaussians
        units : units of the channel

        Returns
        -------
        coefficients [1/mm], differentiable
        """
        place = torch.sigmoid(model.fractions) * (len(self.mixtures) - 2)
        below = place.detach().floor()
        part, first = place - below, below[:, 0].long()
        mixture = (1 - part) * self.mixtures[first] + part * self.mixtures[first + 1]
        return units.density * model.density() * mixture

    def start(self, attenuation: Float[np.ndarray, " gaussian"]) -> Float[Tensor, "gaussian 1"]:
        """Find the fractions of the materials whose attenuation is nearest, between two materials in proportion.

        Parameters
        ----------
        attenuation : at the energy of the curve [1/mm]

        Returns
        -------
        fractions before the sigmoid
        """
        last = len(self.curve.attenuations) - 1
        place = np.interp(attenuation, self.curve.attenuations, np.arange(last + 1)) / max(last, 1)
        return torch.logit(torch.from_numpy(np.clip(place, INSIDE, 1 - INSIDE))).float()[:, None]

    def images(
        self, centres: Float[Tensor, "gaussian 3"], model: FactorisedGaussians, units: Units, geometry: Geometry
    ) -> Image:
        """Compute log projections in some views.

        Parameters
        ----------
        centres : centres in place of those of the model (x, y, z) [mm]
        model : Gaussians
        units : units of the channel
        geometry : poses of the views

        Returns
        -------
        log projections [no unit], differentiable
        """
        parts = (centres, model.log_scales(units), model.quaternions, self.coefficients(model, units))
        lengths = line_integrals(*parts, geometry, "local-affine").movedim(1, -1)
        shape = lengths.shape[:-1]
        logs = self.logs_of(lengths.reshape(-1, lengths.shape[-1]), np.arange(lengths[..., 0].numel()))
        return logs[:, 0].reshape(shape)[:, None]

    def volumes(self, model: FactorisedGaussians, units: Units, grid: Grid) -> Float[np.ndarray, "basis z y x"]:
        """Compute the coefficients on a grid.

        Parameters
        ----------
        model : Gaussians
        units : units of the channel
        grid : grid of the volumes

        Returns
        -------
        volumes [1/mm]
        """
        with torch.no_grad():
            log_scales, coefficients = model.log_scales(units), self.coefficients(model, units)
        return voxelize(model.centres.detach(), log_scales, model.quaternions.detach(), coefficients, grid)


@dataclass(frozen=True)
class GaussianPoly(Splatting):
    """Polychromatic Gaussians of one channel, as a `recon.voxel.method.CountsMethod`.

    Parameters
    ----------
    iterations : Adam steps; twice as many as for other methods that splat, which have several channels
    density_share, volume_tv, patch : as in `recon.published_methods.splatting.r2_gaussian.GaussianMono`
    curve : materials of the object, water among them
    """

    iterations: int = 1000
    density_share: float = 0.15
    volume_tv: float = 0.05
    patch: int = 16
    curve: MaterialCurve | None = None

    name: ClassVar[str] = "gaussian-poly"

    @without_other_pools()
    def reconstruct_counts(
        self, measurements: Measurements, grid: Grid, on_iteration: OnIteration = no_callback
    ) -> Volumes:
        """Reconstruct volumes from the counts of one channel.

        Parameters
        ----------
        measurements : views of a circular orbit, unbinned
        grid : the volume to reconstruct
        on_iteration : called every few steps

        Returns
        -------
        volumes of the bases [1/mm]; zeros where the water-corrected start is nowhere positive

        Raises
        ------
        InputError
            When there is no curve of materials with water, or more than one channel.
        """
        curve = known(self.curve, self.name)
        if measurements.counts.shape[1] != 1:
            raise InputError(f"the method {self.name} takes one channel, got {measurements.counts.shape[1]}")
        lines, data = lines_of_water(measurements, grid, curve)
        start = filtered(lines, data, grid)
        if not (start > 0).any():
            return np.zeros((len(data.basis_names), *grid.shape), np.float32)
        primitives, recipe = Polychromatic(curve, data), self.recipe
        units = units_of(start, grid, recipe)
        model = first_gaussians(start, grid, np.ones(1), units, recipe)
        model.fractions = primitives.start(_values_at(start, grid, model))
        seen = np.broadcast_to(data.gains[0] > 0, data.counts[:, 0].shape)
        images = log_projections(data)[0]
        training = Training(model, primitives, images, seen.copy(), data.geometry, grid, units, recipe)

        def report(step: int, residual: float) -> None:
            volumes = primitives.volumes(training.model, units, grid)
            on_iteration(Iteration(step, recipe.steps, residual, volumes))

        train([training], len(data.geometry), recipe, report)
        return primitives.volumes(training.model, units, grid)


def _values_at(
    volume: Float[np.ndarray, "z y x"], grid: Grid, model: FactorisedGaussians
) -> Float[np.ndarray, " gaussian"]:
    """Values of the voxels at whose centres the first Gaussians are."""
    origin, spacing = np.array(grid.origin), np.array(grid.spacing)
    return volume[tuple(np.round((model.centres.numpy()[:, ::-1] - origin) / spacing).astype(int).T)]
