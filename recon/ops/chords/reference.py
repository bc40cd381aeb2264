"""Chords of ellipsoids, dense and in float64: the truth that the kernels are tested against."""

import torch
from jaxtyping import Float
from torch import Tensor

from recon.ops.rasterize.reference import whitening


def chords(
    centres: Float[Tensor, "ellipsoid 3"],
    log_axes: Float[Tensor, "ellipsoid 3"],
    quaternions: Float[Tensor, "ellipsoid 4"],
    coefficients: Float[Tensor, "ellipsoid basis"],
    frames: Float[Tensor, "view 4 3"],
    rows: int,
    columns: int,
    smooth: float,
) -> Float[Tensor, "view basis row column"]:
    """Compute 2 |d| root(1 - |u x v|^2 / |v|^2) / |v| for every ray and ellipsoid, times the coefficients.

    Parameters
    ----------
    centres, log_axes, quaternions, coefficients, frames, rows, columns, smooth : as in `recon.ops.chords.chords`

    Returns
    -------
    line integrals, dimensionless
    """
    matrices = whitening(log_axes, quaternions)
    row, column = (torch.arange(n, dtype=torch.float64) for n in (rows, columns))
    images = []
    for origin, first, column_step, row_step in frames.double():
        rays = first + column[:, None] * column_step + row[:, None, None] * row_step
        u, v = torch.einsum("nij,nj->ni", matrices, centres - origin), torch.einsum("nij,rcj->rcni", matrices, rays)
        length = v.norm(dim=-1)
        inside = 1 - torch.linalg.cross(u.expand_as(v), v).square().sum(-1) / length**2
        path = 2 * rays.norm(dim=-1)[..., None] / length * root(inside, smooth)
        images.append(torch.einsum("rcn,nm->mrc", path, coefficients))
    return torch.stack(images)


def root(t: Float[Tensor, "..."], smooth: float) -> Float[Tensor, "..."]:
    """Compute the square root of t > 0, a parabola below `smooth`, and 0 for t < 0.

    Parameters
    ----------
    t : 1 - (distance of the ray from the centre / radius)^2
    smooth : t below which the parabola replaces the root

    Returns
    -------
    half the chord over the radius
    """
    part = t.clamp(0, smooth) / smooth
    return torch.sqrt(t.clamp(min=smooth)) + smooth**0.5 * ((3 * part - part * part) / 2 - 1)
