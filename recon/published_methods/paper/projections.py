"""Line integrals of the bases through every pixel of a view (eq. 5), the gradient on the panel, and log projections."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from phantomgen.geometry.poses import Geometry
from recon.data.measurements import Measurements
from recon.data.readout_noise import without_floor
from recon.ops.rasterize import Projector, rasterize


def line_integrals(
    centres: Float[Tensor, "gaussian 3"],
    log_scales: Float[Tensor, "gaussian 3"],
    quaternions: Float[Tensor, "gaussian 4"],
    coefficients: Float[Tensor, "gaussian basis"],
    geometry: Geometry,
    projector: str,
) -> Float[Tensor, "view basis row column"]:
    """The projector of the fit: pixel centres are sampled, as in R2-Gaussian.

    `projector` is ``local-affine``, the rectified footprint of R2-Gaussian, or ``exact``.
    """
    frames = torch.from_numpy(geometry.ray_frames())
    parts = (centres, log_scales, quaternions, coefficients)
    panel = geometry.panel
    return rasterize(*parts, frames, panel.rows, panel.columns, Projector(footprint=0.0, kind=projector))


def detector_gradient(
    centres: Float[Tensor, "gaussian 3"], gradient: Float[Tensor, "gaussian 3"], geometry: Geometry
) -> Float[Tensor, " gaussian"]:
    """Length of a gradient in normalised detector coordinates, in which the panel of one view spans -1 to 1.

    A Gaussian at p = o + t (d0 + x du + y dv) that moves by one pixel at the same depth t moves by t du or t dv.
    """
    origin, first, column, row = torch.from_numpy(geometry.ray_frames()[0])
    depth = torch.linalg.solve(torch.stack([column, row, first], -1), (centres.double() - origin).mT)[2].to(gradient)
    across = gradient @ column.to(gradient) * (geometry.panel.columns / 2)
    down = gradient @ row.to(gradient) * (geometry.panel.rows / 2)
    return depth * torch.hypot(across, down)


LEAST = 0.5  # counts; a pixel that counted nothing is taken to have counted this much


@dataclass(frozen=True, eq=False)
class Projections:
    """Counts of some views, and what the same pixels count without an object.

    Parameters
    ----------
    counts : measured counts
    open_beam : from flat-field frames, with each view's exposure; 0 where nothing was measured
    geometry : poses of the views
    """

    counts: Float[np.ndarray, "view channel row column"]
    open_beam: Float[np.ndarray, "view channel row column"]
    geometry: Geometry

    @classmethod
    def of(cls, measured: Measurements) -> "Projections":
        """From measurements; what noise of the electronics adds to counts is taken out again."""
        bare, floor = without_floor(measured.transmission)
        if floor.any():
            measured = measured.shifted(-floor, bare)
        air = measured.gains * measured.open_beam * measured.exposure[:, :, None, None]
        return cls(measured.counts, air.astype(np.float32), measured.geometry)

    def __len__(self) -> int:
        return len(self.counts)

    def log(self, views: slice) -> Float[Tensor, "view channel row column"]:
        """-log(I / I_0); 0 where nothing was measured."""
        air = torch.from_numpy(self.open_beam[views])
        counts = torch.from_numpy(self.counts[views]).clamp_min(LEAST)
        return torch.where(air > 0, torch.log(air.clamp_min(LEAST) / counts), 0.0)
