"""Numbers of divided Gaussians seen in a view, by torch in float64, differentiable (`recon.ops.interface.table`)."""

from typing import NamedTuple

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from recon.ops.interface.arrays import DividedTensors
from recon.ops.rasterize.footprints import footprints as plain_footprints
from recon.ops.rasterize.footprints import whitening
from recon.ops.rasterize.projector import Projector


class Footprints(NamedTuple):
    """Footprints of all Gaussians in some views.

    Parameters
    ----------
    numbers : see `recon.ops.interface.table`
    rows : first row of each footprint, and one past its last; equal where there is none
    near : per view the Gaussians that come near the source or the panel, which have no footprint there
    """

    numbers: Float[Tensor, "view gaussian 21"]
    rows: Float[Tensor, "view gaussian 2"]
    near: tuple[Int64[Tensor, " near"], ...]


def footprints(
    gaussians: DividedTensors,
    frames: Float[Tensor, "view 4 3"],
    panel: tuple[int, int],
    projector: Projector,
) -> Footprints:
    """Compute the footprints of divided Gaussians in views.

    Parameters
    ----------
    gaussians : the Gaussians, in float64; their coefficients are not used
    frames : per view source, d0, column step and row step [mm]
    panel : rows and columns
    projector : over which area a pixel averages, and where Gaussians end

    Returns
    -------
    footprints, differentiable in centres, log-scales, quaternions and planes

    Notes
    -----
    The mean over a pixel of variance V has, for a footprint of covariance C, the centre of mass C (C + V)^-1 x of the
    Gaussian's part in the pixel, and the variance C - C (C + V)^-1 C there. So z is taken at that point, and the
    variance of its numerator is added under its root.
    """
    centres, log_scales, quaternions, planes = gaussians[:4]
    matrices = whitening(log_scales, quaternions)
    numbers, rows, ends = [], [], []
    for frame in frames:
        plain, near = plain_footprints(centres, matrices, frame, panel, projector)
        seen = (plain.bounds[:, 1] > plain.bounds[:, 0]) & (plain.numbers[:, 10] != 0)
        interface = _interface(centres, matrices, planes, frame, projector.box, seen)
        numbers.append(torch.cat([plain.numbers, interface], 1))
        rows.append(plain.bounds[:, :2])
        ends.append(near)
    return Footprints(torch.stack(numbers), torch.stack(rows), tuple(ends))


def _interface(
    centres: Tensor, matrices: Tensor, planes: Tensor, frame: Tensor, box: float, seen: Tensor
) -> Float[Tensor, "gaussian 10"]:
    """The ten numbers of the plane in one view; 0 where a Gaussian is not seen."""
    offset = centres - frame[0]
    inverse = torch.linalg.inv(torch.stack([frame[2], frame[3], frame[1]], -1))
    depth = torch.where(seen, (offset @ inverse.mT)[:, 2], 1.0)[:, None]
    u, vx, vy = ((matrices @ x[..., None])[..., 0] for x in (offset, frame[2], frame[3]))
    u = torch.where(seen[:, None], u, torch.ones_like(u))
    v = u / depth
    d0 = (v * v).sum(-1, keepdim=True)
    step = torch.stack([vx, vy], -1)  # (gaussian, 3, 2)
    third, along = step[:, 2], (u[:, :, None] * step).sum(1)  # third component and u . step, for both steps
    slope = (third * (u * u).sum(-1, keepdim=True) - u[:, 2:] * along) / depth / d0
    gram = step.mT @ step
    bend = (
        0.5 * (third[:, :, None] * along[:, None] + along[:, :, None] * third[:, None]) - u[:, 2:, None] * gram
    ) / d0[..., None]
    root = torch.sqrt(d0)
    tilt, lean = v[:, 2:] / root, third / root
    shrink = _shrinkage(u, vx, vy, depth, d0, box, seen)
    spread = box * torch.einsum("ni,nij,nj->n", slope, shrink, slope)
    slope = torch.einsum("nij,nj->ni", shrink, slope)
    lean = torch.einsum("nij,nj->ni", shrink, lean)
    bend = shrink @ bend @ shrink
    width = planes[:, 1] ** 2 + spread
    columns = [
        planes[:, 0], slope[:, 0], slope[:, 1], bend[:, 0, 0], 2 * bend[:, 0, 1], bend[:, 1, 1],
        tilt[:, 0], lean[:, 0], lean[:, 1], width,
    ]  # fmt: skip
    return torch.where(seen[:, None], torch.stack(columns, 1), 0.0)


def _shrinkage(
    u: Tensor, vx: Tensor, vy: Tensor, depth: Tensor, d0: Tensor, box: float, seen: Tensor
) -> Float[Tensor, "gaussian 2 2"]:
    """C (C + box)^-1, where C is the covariance of a footprint in pixels: symmetric, as both commute."""
    one = torch.eye(2, dtype=u.dtype, device=u.device).expand(len(u), 2, 2)
    if box == 0:
        return one
    a, b = torch.linalg.cross(u, vx), torch.linalg.cross(u, vy)
    precision = torch.stack([(a * a).sum(-1), (a * b).sum(-1), (a * b).sum(-1), (b * b).sum(-1)], -1).reshape(-1, 2, 2)
    precision = torch.where(seen[:, None, None], precision / d0[..., None], one)
    return torch.linalg.inv(one + box * precision)
