"""Line integrals of the bases through every pixel of a view (eq. 5), and where their gradient pulls on the panel."""

import torch
from jaxtyping import Float
from torch import Tensor

from phantomgen.geometry.poses import Geometry
from recon.ops.rasterize import rasterize


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
    return rasterize(*parts, frames, panel.rows, panel.columns, footprint=0.0, projector=projector)


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
