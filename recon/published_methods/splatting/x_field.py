"""Ellipsoids of constant attenuation with chord lengths, after X-Field.

Each ellipsoid has one attenuation per channel, and adds it times the chord of a ray to the line integral:
`recon.ops.chords` describes how outlines are smoothed, where the derivative of a chord is infinite. Simplified:
attenuations add up where ellipsoids overlap, in place of an order of precedence; the start is a filtered
back-projection, and clone, split and prune are those of R2-Gaussian, in place of progressive and material-based steps.
The volume is that of the ellipsoids, without another reconstruction from rendered views.

References
----------
Wang, Tao, Wu, Wang, Duan, Wang, Yang, Yan 2025, X-Field: a physically grounded representation for 3D X-ray
reconstruction, arXiv:2503.08596.
"""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from recon.ops.chords import chords, fill
from recon.published_methods.paper.model import FactorisedGaussians, Units
from recon.published_methods.splatting.primitives import Image, VolumePrimitives
from recon.published_methods.splatting.volume_method import VolumeSplatting

RADII = math.sqrt(5)  # no unit; semi-axes over the standard deviations of the Gaussian with the same second moments


class Chords(VolumePrimitives):
    """Ellipsoids of constant attenuation that have the second moments of the model's Gaussians."""

    def images(
        self, centres: Float[Tensor, "gaussian 3"], model: FactorisedGaussians, units: Units, geometry: Geometry
    ) -> Image:
        """Compute attenuation times chord length in some views, summed over ellipsoids.

        Parameters
        ----------
        centres : centres in place of those of the model (x, y, z) [mm]
        model : ellipsoids
        units : units of the channel
        geometry : poses of the views

        Returns
        -------
        line integrals [no unit], differentiable
        """
        parts = (centres, _log_axes(model, units), model.quaternions, units.density * model.density())
        return chords(*parts, torch.from_numpy(geometry.ray_frames()), geometry.panel.rows, geometry.panel.columns)

    def volume(self, model: FactorisedGaussians, units: Units, grid: Grid) -> Float[np.ndarray, "z y x"]:
        """Compute attenuation on a grid.

        Parameters
        ----------
        model : ellipsoids
        units : units of the channel
        grid : grid of the volume

        Returns
        -------
        volume [1/mm]
        """
        inside = units.density * model.density()[:, 0]
        return fill(model.centres, _log_axes(model, units), model.quaternions, inside, grid)


@dataclass(frozen=True)
class Ellipsoid(VolumeSplatting):
    """Ellipsoids of constant attenuation as a method.

    Parameters
    ----------
    density_share : attenuation of an ellipsoid over that of its voxel at the start
    """

    density_share: float = 0.06

    primitives: ClassVar[Chords] = Chords()

    @property
    def name(self) -> str:
        """Name of the method for ``--method``."""
        return "ellipsoid"


def _log_axes(model: FactorisedGaussians, units: Units) -> Float[Tensor, "gaussian 3"]:
    """Logarithm of the semi-axes [log mm]."""
    return model.log_scales(units) + math.log(RADII)
