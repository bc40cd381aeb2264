"""Line integrals of Gaussians, dense and in float64: the truth that the kernels are tested against."""

import itertools
import math

import torch
from jaxtyping import Float
from torch import Tensor


def rotation(quaternions: Float[Tensor, "gaussian 4"]) -> Float[Tensor, "gaussian 3 3"]:
    """Compute rotation matrices.

    Parameters
    ----------
    quaternions : (w, x, y, z); normalised here

    Returns
    -------
    matrices whose columns are the rotated axes
    """
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
    """Compute whitening matrices A = S^-1 R^T.

    Parameters
    ----------
    log_scales : logarithm of the standard deviations [log mm]
    quaternions : orientation (w, x, y, z)

    Returns
    -------
    matrices [1/mm]: |A (x - p)| is the distance of x from the centre p in standard deviations
    """
    return torch.exp(-log_scales)[:, :, None] * rotation(quaternions).mT


def lattice_mass(
    centres: Float[Tensor, "gaussian axis"], covariances: Float[Tensor, "gaussian axis axis"]
) -> Float[Tensor, " gaussian"]:
    """Sum Gaussian densities of unit mass over all integer points; not quite 1 for narrow ones.

    Parameters
    ----------
    centres : in units of the spacing of the points
    covariances : in the same units, squared

    Returns
    -------
    sum of each density

    Notes
    -----
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
    """Compute the line integral of every basis along the ray of every pixel, from the source to the panel.

    Parameters
    ----------
    centres, log_scales, quaternions, coefficients, frames, rows, columns : as in `recon.ops.rasterize.rasterize`
    footprint : edge of the square that a pixel averages over [pixels]; 0 samples the pixel centre

    Returns
    -------
    line integrals, dimensionless

    Notes
    -----
    With u = A (p - o) and v = A d the integral of exp(-|A (o + t d - p)|^2 / 2) over the whole line is
    |d| sqrt(2 pi) / |v| exp(-|m|^2 / (2 |v|^2)), m = u x v; the closest point is z0 = u.v / |v| standard deviations
    behind the source, so that the part (erf(z0 / sqrt 2) + erf((|v| - z0) / sqrt 2)) / 2 of it lies on the ray.
    A step in pixels moves m by J = [u x A du, u x A dv]. Averaging over a pixel of edge `footprint` adds
    footprint^2 / 12 to the covariance of the footprint in pixels, which in units of m is c J J^T with
    c = footprint^2 / 12 depth^2 / |u|^2, and keeps its mass; dividing by the sum of the footprint over the pixels keeps
    the mass also where a footprint is too narrow to be sampled evenly. The part on the ray is that of the ray through
    where the Gaussian is seen, in the mean c J^T (1 + c J J^T)^-1 m pixels before the pixel's centre. Nothing is
    measured from the projected centre, which may be at infinity.
    """
    matrices = whitening(log_scales, quaternions)
    images = []
    for origin, first, du, dv in frames.double():
        offset = centres - origin
        h = torch.linalg.solve(torch.stack([du, dv, first], -1), offset.mT).mT
        u, vx, vy = ((matrices @ x[..., None])[..., 0] for x in (offset, du, dv))
        plane, step = torch.linalg.qr(torch.stack([torch.linalg.cross(u, vx), torch.linalg.cross(u, vy)], -1))
        ratio = (h[:, 2] ** 2 / (u * u).sum(-1))[:, None, None]
        wide = torch.eye(2, dtype=u.dtype) + footprint**2 / 12 * ratio * (step @ step.mT)
        mass_kept = torch.linalg.det(wide) ** -0.5
        if footprint >= 1:
            pixels = footprint**2 / 12 * torch.eye(2, dtype=u.dtype) + torch.linalg.inv(ratio * (step.mT @ step))
            mass_kept = mass_kept / lattice_mass(h[:, :2] / h[:, 2:], pixels)

        directions = _directions(first, du, dv, rows, columns)
        v = torch.einsum("nij,rcj->rcni", matrices, directions)
        length = v.norm(dim=-1)
        m = torch.einsum("nij,rcni->rcnj", plane, torch.linalg.cross(u.expand_as(v), v))
        smooth = torch.einsum("nij,rcnj->rcni", torch.linalg.inv(wide), m)
        square = (m * smooth).sum(-1) / length**2
        shift = footprint**2 / 12 * torch.einsum("n,nij,rcni->rcnj", ratio[:, 0, 0], step, smooth)
        seen = v - shift[..., :1] * vx - shift[..., 1:] * vy
        end = seen.norm(dim=-1)
        z = torch.einsum("ni,rcni->rcn", u, seen) / end
        part = (torch.erf(z / math.sqrt(2)) + torch.erf((end - z) / math.sqrt(2))) / 2
        kernel = mass_kept * part * math.sqrt(2 * math.pi) / length * torch.exp(-square / 2)
        images.append(torch.einsum("rcn,nm,rc->mrc", kernel, coefficients, directions.norm(dim=-1)))
    return torch.stack(images)


def local_affine(
    centres: Float[Tensor, "gaussian 3"],
    log_scales: Float[Tensor, "gaussian 3"],
    quaternions: Float[Tensor, "gaussian 4"],
    coefficients: Float[Tensor, "gaussian basis"],
    frames: Float[Tensor, "view 4 3"],
    rows: int,
    columns: int,
    footprint: float,
) -> Float[Tensor, "view basis row column"]:
    """Compute line integrals by rectified splatting: Gaussians in the panel, exact on the ray through the centre only.

    Parameters
    ----------
    centres, log_scales, quaternions, coefficients, frames, rows, columns : as in `recon.ops.rasterize.rasterize`
    footprint : edge of the square that a pixel averages over [pixels]; 0 samples the pixel centre

    Returns
    -------
    line integrals, dimensionless

    Notes
    -----
    The covariance of such a Gaussian is P Sigma P^T, with P the derivative of the projection at the centre, and its
    height is sqrt(2 pi / (e^T Sigma^-1 e)) for a unit vector e along the ray. Pixels average as in `rasterize`.
    """
    matrices = whitening(log_scales, quaternions)
    inverse = torch.linalg.inv(matrices)
    images = []
    for origin, first, du, dv in frames.double():
        offset = centres - origin
        solver = torch.linalg.inv(torch.stack([du, dv, first], -1))
        h = offset @ solver.mT
        centre, depth = h[:, :2] / h[:, 2:], h[:, 2, None, None]
        slope = (solver[:2] - centre[:, :, None] * solver[2]) / depth
        narrow = (slope @ inverse) @ (slope @ inverse).mT
        wide = narrow + footprint**2 / 12 * torch.eye(2, dtype=narrow.dtype)
        mass_kept = torch.sqrt(torch.linalg.det(narrow) / torch.linalg.det(wide))
        if footprint >= 1:
            mass_kept = mass_kept / lattice_mass(centre, wide)
        along = (matrices @ (offset / offset.norm(dim=-1, keepdim=True))[..., None])[..., 0].norm(dim=-1)
        y, x = torch.meshgrid(torch.arange(rows), torch.arange(columns), indexing="ij")
        delta = torch.stack([x, y], -1)[:, :, None, :] - centre
        square = torch.einsum("rcni,nij,rcnj->rcn", delta, torch.linalg.inv(wide), delta)
        kernel = mass_kept * math.sqrt(2 * math.pi) / along * torch.exp(-square / 2)
        kernel = kernel * ((h[:, 2] > 0) & (h[:, 2] < 1))
        images.append(torch.einsum("rcn,nm->mrc", kernel, coefficients))
    return torch.stack(images)


def _directions(first: Tensor, du: Tensor, dv: Tensor, rows: int, columns: int) -> Float[Tensor, "row column 3"]:
    """Compute the vectors from the source to every pixel [mm]."""
    along = torch.arange(columns, dtype=torch.float64)[None, :, None] * du + first
    return along + torch.arange(rows, dtype=torch.float64)[:, None, None] * dv
