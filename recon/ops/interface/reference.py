"""Line integrals of Gaussians divided by a plane, dense and in float64, which the kernels are tested against."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from recon.ops.interface.arrays import DividedTensors
from recon.ops.rasterize.reference import whitening


def line_integrals(
    gaussians: DividedTensors,
    origins: Float[Tensor, "ray 3"],
    directions: Float[Tensor, "ray 3"],
) -> Float[Tensor, "ray basis"]:
    """Integral of every basis along whole lines.

    Parameters
    ----------
    gaussians : the Gaussians
    origins, directions : points and directions of the rays [mm]; directions of any length

    Returns
    -------
    Line integrals, dimensionless.

    Notes
    -----
    With the whitened coordinates w = S^-1 R^T (x - p) the density is
    exp(-|w|^2 / 2) (below + (above - below) Phi((w_3 - offset) / width)), where Phi is the normal distribution
    function. Along o + t d, u = A (o - p) and v = A d, the Gaussian has its maximum at t_0 = -u.v / |v|^2 and the
    standard deviation 1 / |v|. The mean of Phi over it is Phi at the mean of its argument over the root of 1 plus the
    variance of its argument (Owen 1980, doi:10.1080/03610918008812164, integral 10,010.8), so that the integral is
    sqrt(2 pi) |d| / |v| exp(-|u x v|^2 / (2 |v|^2)) (below + (above - below) Phi(z)) with
    z = (u_3 + t_0 v_3 - offset) / sqrt(width^2 + v_3^2 / |v|^2).
    """
    centres, log_scales, quaternions, planes, below, above = gaussians
    matrices = whitening(log_scales, quaternions)
    u = torch.einsum("nij,rnj->rni", matrices, origins[:, None] - centres)
    v = torch.einsum("nij,rj->rni", matrices, directions)
    square = (v * v).sum(-1)
    plain = torch.exp(-0.5 * (torch.linalg.cross(u, v) ** 2).sum(-1) / square) * torch.sqrt(2 * math.pi / square)
    closest = -(u * v).sum(-1) / square
    offset, width = planes.unbind(1)
    z = (u[..., 2] + closest * v[..., 2] - offset) / torch.sqrt(width**2 + v[..., 2] ** 2 / square)
    part = torch.special.ndtr(z)
    lengths = directions.norm(dim=-1)
    return lengths[:, None] * (torch.einsum("rn,nm->rm", plain * (1 - part), below) + (plain * part) @ above)
