"""The numbers of divided Gaussians in views and on a grid, by torch in float64, differentiable.

The steps are those of `recon.ops.interface.cpu_footprints` and `recon.ops.interface.cpu_voxel_table`, whose notes say
what they mean.
"""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from phantomgen.geometry.voxel_grid import Grid
from recon.ops.interface.arrays import DividedTensors
from recon.ops.interface.cpu_voxel_table import FARTHEST, VOXEL
from recon.ops.interface.table import B0, Q1
from recon.ops.rasterize.footprint_table import Footprints
from recon.ops.rasterize.footprints import ExactFootprints, PlacedGaussians, footprints, placed, whitening
from recon.ops.rasterize.projector import Projector
from recon.ops.voxelize.cpu import SLACK
from recon.ops.voxelize.gpu import Ellipsoids
from recon.ops.voxelize.gpu_calls import lattice_mass


class SeenGaussians:
    """Divided Gaussians in some views.

    Parameters
    ----------
    centres : centres [mm]
    matrices : whitening matrices [1/mm]
    planes : offset and width of each plane [standard deviations of the third axis]
    frames : per view source, d0, column step and row step [mm]
    panel : rows and columns
    projector : how Gaussians are projected
    """

    def __init__(
        self,
        centres: Float[Tensor, "gaussian 3"],
        matrices: Float[Tensor, "gaussian 3 3"],
        planes: Float[Tensor, "gaussian 2"],
        frames: Float[Tensor, "view 4 3"],
        panel: tuple[int, int],
        projector: Projector,
    ) -> None:
        places = placed(centres, matrices, frames, projector)
        self.near: Bool[Tensor, "view gaussian"] = places.near
        self._plain = footprints(places, panel, projector)
        more = _plane_in_views(places, planes, projector.box)
        self.numbers: Float[Tensor, "view gaussian 21"] = torch.cat([self._plain.numbers, more], -1)

    def rounded(self) -> Footprints:
        """Round to the types of the kernels.

        Returns
        -------
        footprints with the numbers of `recon.ops.interface.table`
        """
        return ExactFootprints(self.numbers, self._plain.bounds).rounded()

    def gradients(self, sums: Float[Tensor, "view gaussian 23"]) -> Float[Tensor, "view gaussian 21"]:
        """Compute the gradients in the numbers from sums over pixels.

        Parameters
        ----------
        sums : as in `recon.ops.interface.cpu.backward`

        Returns
        -------
        gradient in each number
        """
        plain = self._plain.gradients(sums[..., :12], affine=False)
        q1, q2, q3, q4, q5 = self.numbers.detach()[..., Q1:B0].unbind(-1)
        _, b1, b2 = self.numbers.detach()[..., B0 : B0 + 3].unbind(-1)
        to_offset, q, qx, qy, qxx, qxy, qyy, b, bx, by, to_width = sums[..., 12:].unbind(-1)
        to_x = plain[..., 0] - (q1 * q + 2 * q3 * qx + q4 * qy) - b1 * b
        to_y = plain[..., 1] - (q2 * q + q4 * qx + 2 * q5 * qy) - b2 * b
        more = [to_offset, qx, qy, qxx, qxy, qyy, b, bx, by, to_width]
        return torch.cat([torch.stack([to_x, to_y], -1), plain[..., 2:], torch.stack(more, -1)], -1)


def _plane_in_views(
    seen: PlacedGaussians, planes: Float[Tensor, "gaussian 2"], box: float
) -> Float[Tensor, "view gaussian 10"]:
    """Compute OFFSET, Q1 to Q5, B0 to B2 and WIDTH: the steps of `cpu_footprints._measure_plane`."""
    u, vx, vy, a, b, depth = seen.u, seen.vx, seen.vy, seen.a, seen.b, seen.depth
    ux, uy, square = (u * vx).sum(-1), (u * vy).sum(-1), (u * u).sum(-1)
    d0 = square / depth**2
    root = torch.sqrt(d0)
    u3, x3, y3 = u[..., 2], vx[..., 2], vy[..., 2]
    slope = torch.stack([x3 * square - u3 * ux, y3 * square - u3 * uy], -1) / (depth * d0)[..., None]
    bend = [
        x3 * ux - u3 * (vx * vx).sum(-1),
        0.5 * (x3 * uy + y3 * ux) - u3 * (vx * vy).sum(-1),
        y3 * uy - u3 * (vy * vy).sum(-1),
    ]
    xx, xy, yy = (value / d0 for value in bend)
    m11, m12, m22 = (box * (p * q).sum(-1) / d0 for p, q in ((a, a), (a, b), (b, b)))
    m11, m22 = 1 + m11, 1 + m22
    det = m11 * m22 - m12 * m12
    sxx, sxy, syy = m22 / det, -m12 / det, m11 / det
    f11, f12, f21, f22 = sxx * xx + sxy * xy, sxx * xy + sxy * yy, sxy * xx + syy * xy, sxy * xy + syy * yy
    slope_x, slope_y = slope.unbind(-1)
    q1, q2 = sxx * slope_x + sxy * slope_y, sxy * slope_x + syy * slope_y
    lean_x, lean_y = x3 / root, y3 / root
    numbers = [
        planes[:, 0].expand_as(q1), q1, q2,
        f11 * sxx + f12 * sxy, 2 * (f11 * sxy + f12 * syy), f21 * sxy + f22 * syy,
        u3 / (depth * root), sxx * lean_x + sxy * lean_y, sxy * lean_x + syy * lean_y,
        planes[:, 1] ** 2 + box * (slope_x * q1 + slope_y * q2),
    ]  # fmt: skip
    return torch.where(seen.seen[..., None], torch.stack(numbers, -1), 1.0)


class GaussiansOnGrid:
    """Divided Gaussians on a grid.

    Parameters
    ----------
    gaussians : in float64
    grid : voxels
    """

    def __init__(self, gaussians: DividedTensors, grid: Grid) -> None:
        centres, log_scales, quaternions, planes = gaussians[:4]
        origin, spacing = (centres.new_tensor(values[::-1]) for values in (grid.origin, grid.spacing))
        matrices, one = whitening(log_scales, quaternions), torch.eye(3, dtype=centres.dtype, device=centres.device)
        place = (centres - origin) / spacing
        self._voxels = torch.floor(place.detach() + 0.5).clamp(-FARTHEST, FARTHEST)
        offsets = place - self._voxels
        a = matrices * spacing
        axes = matrices.mT * torch.exp(2 * log_scales)[:, None] / spacing[:, None]  # times those of the scales
        wide = axes @ axes.mT + VOXEL * one
        square = a.mT @ a
        part, det = _inverse(one + VOXEL * square)
        precision = part @ square
        u11 = torch.sqrt(precision[:, 0, 0])
        u12, u13 = precision[:, 0, 1] / u11, precision[:, 0, 2] / u11
        u22 = torch.sqrt(precision[:, 1, 1] - u12 * u12)
        u23 = (precision[:, 1, 2] - u12 * u13) / u22
        u33 = 1 / torch.sqrt(wide[:, 2, 2])
        slope = (part @ a[:, 2, :, None])[:, :, 0]
        root = torch.sqrt(planes[:, 1] ** 2 + VOXEL * (slope * a[:, 2]).sum(1))
        amplitude = 1 / (torch.sqrt(det) * lattice_mass(offsets, wide))
        shape = torch.stack([u11, u12, u13, u22, u23, u33, amplitude, -planes[:, 0] / root], 1)
        self.numbers: Float[Tensor, "gaussian 14"] = torch.cat([offsets, shape, slope / root[:, None]], 1)
        self._variances = torch.diagonal(wide.detach(), dim1=1, dim2=2)

    def rounded(self, shape: tuple[int, int, int], cutoff: float) -> Ellipsoids:
        """Round to the types of the kernels.

        Parameters
        ----------
        shape : of the grid (z, y, x)
        cutoff : where a Gaussian ends [standard deviations]

        Returns
        -------
        Gaussians with the numbers of `recon.ops.interface.voxel_table`
        """
        numbers, size = self.numbers.detach(), torch.tensor(shape[::-1], device=self.numbers.device)
        half, middle = cutoff * torch.sqrt(self._variances) + SLACK, self._voxels + numbers[:, :3]
        first = torch.ceil(middle - half).clamp(min=0).minimum(size)
        last = (torch.floor(middle + half) + 1).minimum(size).maximum(first)
        ends = torch.stack([first, last], -1).flip(1).flatten(1)
        return Ellipsoids(numbers.float().contiguous(), torch.cat([self._voxels, ends], 1).int().contiguous())

    def gradients(self, sums: Float[Tensor, "gaussian 14"]) -> Float[Tensor, "gaussian 14"]:
        """Compute the gradients in the numbers from sums over voxels.

        Parameters
        ----------
        sums : as in `recon.ops.interface.cpu_voxels.backward`

        Returns
        -------
        gradient in each number
        """
        u11, u12, u13, u22, u23, u33, amplitude = self.numbers.detach()[:, 3:10].unbind(1)
        w, wx, wy, wz, wxx, wxy, wxz, wyy, wyz, wzz = sums[:, :10].unbind(1)
        a1, a2, a3 = u11 * wx + u12 * wy + u13 * wz, u22 * wy + u23 * wz, u33 * wz
        to_place = torch.stack([u11 * a1, u12 * a1 + u22 * a2, u13 * a1 + u23 * a2 + u33 * a3], 1)
        to_place = to_place - self.numbers.detach()[:, 11:] * sums[:, 10:11]
        to_shape = [
            -(u11 * wxx + u12 * wxy + u13 * wxz), -(u11 * wxy + u12 * wyy + u13 * wyz),
            -(u11 * wxz + u12 * wyz + u13 * wzz), -(u22 * wyy + u23 * wyz), -(u22 * wyz + u23 * wzz), -u33 * wzz,
            w / amplitude,
        ]  # fmt: skip
        return torch.cat([to_place, torch.stack(to_shape, 1), sums[:, 10:]], 1)


def _inverse(a: Float[Tensor, "gaussian 3 3"]) -> tuple[Float[Tensor, "gaussian 3 3"], Float[Tensor, " gaussian"]]:
    """Invert symmetric matrices; also returns their determinants."""
    (a11, a12, a13), (_, a22, a23), (_, _, a33) = (row.unbind(-1) for row in a.unbind(-2))
    c11, c12, c13 = a22 * a33 - a23 * a23, a13 * a23 - a12 * a33, a12 * a23 - a13 * a22
    c22, c23, c33 = a11 * a33 - a13 * a13, a12 * a13 - a11 * a23, a11 * a22 - a12 * a12
    det = a11 * c11 + a12 * c12 + a13 * c13
    rows = torch.stack([c11, c12, c13, c12, c22, c23, c13, c23, c33], -1).reshape(-1, 3, 3)
    return rows / det[:, None, None], det
