"""Line integrals of Gaussians, dense and in float64: the truth that the kernels are tested against."""

import itertools
import math

import torch
from jaxtyping import Float
from torch import Tensor


def rotation(quaternions: Float[Tensor, "gaussian 4"]) -> Float[Tensor, "gaussian 3 3"]:
    """Rotation matrices of quaternions (w, x, y, z), normalised first."""
    w, x, y, z = torch.nn.functional.normalize(quaternions, dim=-1).unbind(-1)
    rows = [
        torch.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], -1),
        torch.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], -1),
        torch.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], -1),
    ]
    return torch.stack(rows, -2)


def whitening(
    log_scales: Float[Tensor, "gaussian 3"], quaternions: Float[Tensor, "gaussian 4"]
) -> Float[Tensor, "gaussian 3 3"]:
    """A = S^-1 R^T, so that |A (x - p)| is the distance from the centre in standard deviations."""
    return torch.exp(-log_scales)[:, :, None] * rotation(quaternions).mT


def lattice_mass(
    centres: Float[Tensor, "gaussian axis"], covariances: Float[Tensor, "gaussian axis axis"]
) -> Float[Tensor, " gaussian"]:
    """Sum over all integer points of Gaussian densities of unit mass; not quite 1 for narrow ones.

    Poisson summation: 1 + 2 sum_k exp(-2 pi^2 k^T C k) cos(2 pi k.x) over half of the integer vectors k, cut off after
    the nearest neighbours (0.3 % are left per axis for the narrowest, of variance 1/12).
    """
    total = torch.ones_like(centres[:, 0])
    neighbours = [k for k in itertools.product((-1.0, 0.0, 1.0), repeat=centres.shape[1]) if k > (0.0,) * len(k)]
    for k in torch.tensor(neighbours, dtype=centres.dtype):
        decay = torch.exp(-2 * math.pi**2 * torch.einsum("i,nij,j->n", k, covariances, k))
        total = total + 2 * decay * torch.cos(2 * math.pi * centres @ k)
    return total


def rasterize(
    centres: Float[Tensor, "gaussian 3"],
    log_scales: Float[Tensor, "gaussian 3"],
    quaternions: Float[Tensor, "gaussian 4"],
    coefficients: Float[Tensor, "gaussian basis"],
    frames: Float[Tensor, "view 4 3"],
    rows: int,
    columns: int,
    footprint: float,
) -> Float[Tensor, "view basis row column"]:
    """Line integral of every basis along the ray of every pixel.

    With u = A (p - o) and v = A d the integral of exp(-|A (o + t d - p)|^2 / 2) over the ray is
    |d| sqrt(2 pi) / |v| exp(-|u x v|^2 / (2 |v|^2)). In pixels from the projected centre the numerator is a quadratic
    form with matrix J^T J, J = [u x A du, u x A dv]; averaging over a pixel of edge `footprint` adds footprint^2 / 12
    to the covariance of the footprint (J^T J / D0)^-1 and keeps its mass; dividing by the sum of the footprint over
    the pixels keeps the mass also where a footprint is too narrow to be sampled evenly.
    """
    matrices = whitening(log_scales, quaternions)
    images = []
    for origin, first, du, dv in frames.double():
        offset = centres - origin
        h = torch.linalg.solve(torch.stack([du, dv, first], -1), offset.mT).mT
        centre = h[:, :2] / h[:, 2:]
        u, vx, vy = ((matrices @ x[..., None])[..., 0] for x in (offset, du, dv))
        d0 = (u * u).sum(-1) / h[:, 2] ** 2
        jacobian = torch.stack([torch.linalg.cross(u, vx), torch.linalg.cross(u, vy)], -1)
        narrow = torch.linalg.inv(jacobian.mT @ jacobian / d0[:, None, None])
        wide = narrow + footprint**2 / 12 * torch.eye(2, dtype=narrow.dtype)
        mass_kept = torch.sqrt(torch.linalg.det(narrow) / torch.linalg.det(wide))
        if footprint >= 1:
            mass_kept = mass_kept / lattice_mass(centre, wide)

        x = torch.arange(columns, dtype=torch.float64)[None, :, None] * du + first
        directions = x + torch.arange(rows, dtype=torch.float64)[:, None, None] * dv
        v = torch.einsum("nij,rcj->rcni", matrices, directions)
        ratio = (v * v).sum(-1) / d0
        y, x = torch.meshgrid(torch.arange(rows), torch.arange(columns), indexing="ij")
        delta = torch.stack([x, y], -1)[:, :, None, :] - centre
        exponent = torch.einsum("rcni,nij,rcnj->rcn", delta, torch.linalg.inv(wide), delta) / ratio
        kernel = mass_kept * torch.sqrt(2 * math.pi / (d0 * ratio)) * torch.exp(-exponent / 2)
        kernel = kernel * ((h[:, 2] > 0) & (h[:, 2] < 1))
        images.append(torch.einsum("rcn,nm,rc->mrc", kernel, coefficients, directions.norm(dim=-1)))
    return torch.stack(images)
