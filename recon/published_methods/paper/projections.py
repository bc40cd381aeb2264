"""Line integrals of the bases for every pixel (eq. 5), gradients on the panel, and measured log projections."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from phantomgen.geometry.poses import Geometry
from recon.data.measurements import Measurements
from recon.data.readout_noise import without_floor
from recon.ops.rasterize import Projector, rasterize

LEAST = 0.5  # counts; least count of which a logarithm is taken, half of the smallest positive one; our choice


def line_integrals(
    centres: Float[Tensor, "gaussian 3"],
    log_scales: Float[Tensor, "gaussian 3"],
    quaternions: Float[Tensor, "gaussian 4"],
    coefficients: Float[Tensor, "gaussian basis"],
    geometry: Geometry,
    projector: str,
) -> Float[Tensor, "view basis row column"]:
    """Project Gaussians as the paper does, with pixels sampled at their centres as in R2-Gaussian.

    Parameters
    ----------
    centres : centres (x, y, z) [mm]
    log_scales : logarithm of the standard deviations along the principal axes [log mm]
    quaternions : orientation (w, x, y, z)
    coefficients : value of each basis at the centre [1/mm]
    geometry : poses of the views
    projector : ``local-affine``, the rectified footprint of R2-Gaussian, or ``exact``

    Returns
    -------
    line integrals [no unit], differentiable in the first four arguments
    """
    frames = torch.from_numpy(geometry.ray_frames())
    parts = (centres, log_scales, quaternions, coefficients)
    panel = geometry.panel
    return rasterize(*parts, frames, panel.rows, panel.columns, Projector(footprint=0.0, kind=projector))


def detector_gradient(
    centres: Float[Tensor, "gaussian 3"], gradient: Float[Tensor, "gaussian 3"], geometry: Geometry
) -> Float[Tensor, " gaussian"]:
    """Compute the length of a gradient in normalised detector coordinates, in which the panel spans -1 to 1.

    Parameters
    ----------
    centres : centres (x, y, z) [mm]
    gradient : derivative of the loss with respect to the centres [1/mm]
    geometry : pose of one view

    Returns
    -------
    length of the gradient for each Gaussian [no unit]

    Notes
    -----
    A Gaussian at p = o + t (d0 + x du + y dv) that moves by one pixel at the same depth t moves by t du or t dv.
    """
    origin, first, column, row = torch.from_numpy(geometry.ray_frames()[0])
    depth = torch.linalg.solve(torch.stack([column, row, first], -1), (centres.double() - origin).mT)[2].to(gradient)
    across = gradient @ column.to(gradient) * (geometry.panel.columns / 2)
    down = gradient @ row.to(gradient) * (geometry.panel.rows / 2)
    return depth * torch.hypot(across, down)


@dataclass(frozen=True, eq=False)
class Projections:
    """Counts of some views, and the counts of the same pixels without an object.

    Parameters
    ----------
    counts : measured counts
    open_beam : counts without an object, from flat fields, with the exposure of each view; 0 where nothing was measured
    geometry : poses of the views
    """

    counts: Float[np.ndarray, "view channel row column"]
    open_beam: Float[np.ndarray, "view channel row column"]
    geometry: Geometry

    @classmethod
    def of(cls, measured: Measurements) -> "Projections":
        """Create projections from measurements; the mean of the electronic noise is subtracted from the counts.

        Parameters
        ----------
        measured : counts, gains and exposures of the views

        Returns
        -------
        projections of all views
        """
        bare, floor = without_floor(measured.transmission)
        if floor.any():
            measured = measured.shifted(-floor, bare)
        air = measured.gains * measured.open_beam * measured.exposure[:, :, None, None]
        return cls(measured.counts, air.astype(np.float32), measured.geometry)

    def __len__(self) -> int:
        return len(self.counts)

    def view(self, number: int) -> "Projections":
        """Return the projections of one view.

        Parameters
        ----------
        number : index of the view

        Returns
        -------
        projections of one view, which share memory with these
        """
        one = slice(number, number + 1)
        return Projections(self.counts[one], self.open_beam[one], self.geometry[one])

    @property
    def seen(self) -> Bool[Tensor, "view channel row column"]:
        """True for pixels that were measured."""
        return torch.from_numpy(self.open_beam > 0)

    def log(self) -> Float[Tensor, "view channel row column"]:
        """Compute -log(I / I_0).

        Returns
        -------
        log projections [no unit]; 0 where nothing was measured
        """
        air = torch.from_numpy(self.open_beam)
        counts = torch.from_numpy(self.counts).clamp_min(LEAST)
        return torch.where(air > 0, torch.log(air.clamp_min(LEAST) / counts), 0.0)
