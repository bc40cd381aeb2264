"""Footprints of all Gaussians in one view, by torch in float64, differentiable: the steps of `cpu.footprints`."""

import math
from typing import NamedTuple

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from recon.ops.arguments import TINY
from recon.ops.rasterize.footprint_table import NARROWEST, Footprints
from recon.ops.rasterize.near_field import REACH
from recon.ops.rasterize.projector import Projector


class ExactFootprints(NamedTuple):
    """Footprints of all Gaussians in one view, in float64.

    Parameters
    ----------
    numbers : xc, yc, l11, l21, l22, e1 to e5, amplitude; as in `recon.ops.rasterize.cpu`
    bounds : first row, one past the last, first column, one past the last
    """

    numbers: Float[Tensor, "gaussian 11"]
    bounds: Float[Tensor, "gaussian 4"]

    def rounded(self) -> Footprints:
        """Round the footprints to the types of the kernels.

        Returns
        -------
        footprints in float32, bounds as 32-bit integers
        """
        return Footprints(self.numbers.detach().float().contiguous(), self.bounds.int().contiguous())

    def gradients(self, sums: Float[Tensor, "gaussian 12"], affine: bool) -> Float[Tensor, "gaussian 11"]:
        """Compute the gradients in the numbers from sums over pixels.

        Parameters
        ----------
        sums : as in `recon.ops.rasterize.cpu.backward`
        affine : whether the projection is local-affine

        Returns
        -------
        gradient in each number
        """
        _, _, l11, l21, l22, e1, e2, e3, e4, e5, amplitude = self.numbers.detach().unbind(1)
        w, ax, ay, axx, axy, ayy, b, bx, by, bxx, bxy, byy = sums.unbind(1)
        along = l11 * ax + l21 * ay
        bends = [torch.zeros_like(w)] * 5 if affine else [bx, by, bxx, bxy, byy]
        to_x = -2 * l11 * along - (e1 * b + 2 * e3 * bx + e4 * by)
        to_y = -2 * (l21 * along + l22 * l22 * ay) - (e2 * b + e4 * bx + 2 * e5 * by)
        to_l = [2 * (l11 * axx + l21 * axy), 2 * (l11 * axy + l21 * ayy), 2 * l22 * ayy]
        safe = torch.where(amplitude == 0, 1.0, amplitude)
        return torch.stack([to_x, to_y, *to_l, *bends, w / safe], 1)


def whitening(
    log_scales: Float[Tensor, "gaussian 3"], quaternions: Float[Tensor, "gaussian 4"]
) -> Float[Tensor, "gaussian 3 3"]:
    """Compute whitening matrices A = S^-1 R^T.

    Parameters
    ----------
    log_scales : logarithm of the standard deviations [log mm]
    quaternions : orientation (w, x, y, z), not normalised

    Returns
    -------
    matrices [1/mm]
    """
    q = quaternions / quaternions.norm(dim=1, keepdim=True)
    w, vector = q[:, :1, None], q[:, 1:]
    one = torch.eye(3, dtype=q.dtype, device=q.device)
    turned = torch.linalg.cross(vector[:, None].expand(-1, 3, -1), one.expand(len(q), 3, 3))  # rows v x e_i
    square = (vector * vector).sum(1)[:, None, None]
    transposed = (w * w - square) * one + 2 * vector[:, :, None] * vector[:, None] + 2 * w * turned
    return torch.exp(-log_scales)[:, :, None] * transposed


class _View(NamedTuple):
    """Gaussians in whitened coordinates of one view: offset from the source, place, u, vx, vy, u x vx, u x vy."""

    offset: Tensor
    place: Tensor  # inverse frame times offset; the third is the depth
    u: Tensor
    vx: Tensor
    vy: Tensor
    a: Tensor
    b: Tensor


def _in_view(centres: Tensor, matrices: Tensor, frame: Tensor) -> tuple[_View, Tensor]:
    """Whiten the Gaussians in one view; also returns the inverse of the frame."""
    inverse = torch.linalg.inv(torch.stack([frame[2], frame[3], frame[1]], -1))
    offset = centres - frame[0]
    u, vx, vy = ((matrices @ x[..., None])[..., 0] for x in (offset, frame[2], frame[3]))
    a, b = torch.linalg.cross(u, vx), torch.linalg.cross(u, vy)
    return _View(offset, offset @ inverse.mT, u, vx, vy, a, b), inverse


def footprints(
    centres: Float[Tensor, "gaussian 3"],
    matrices: Float[Tensor, "gaussian 3 3"],
    frame: Float[Tensor, "4 3"],
    panel: tuple[int, int],
    projector: Projector,
) -> tuple[ExactFootprints, Int64[Tensor, " near"]]:
    """Compute the footprints of all Gaussians in one view.

    Parameters
    ----------
    centres : centres [mm]
    matrices : whitening matrices [1/mm]
    frame : source, d0, column step and row step [mm]
    panel : rows and columns
    projector : how Gaussians are projected

    Returns
    -------
    footprints, and which Gaussians come near an end of the rays; the bounds of these are empty
    """
    view, inverse = _in_view(centres, matrices, frame)
    seen, near = _places(view, matrices.detach(), inverse, projector)
    box = projector.box
    # Gaussians that are not seen here get finite numbers: those of a Gaussian half way from the source to the panel.
    depth = torch.where(seen, view.place[:, 2], 0.5)
    safe = view._replace(
        u=torch.where(seen[:, None], view.u, 1.0), a=torch.where(seen[:, None], view.a, _axis(view.a, 0)),
        b=torch.where(seen[:, None], view.b, _axis(view.b, 1)),
    )  # fmt: skip
    x, y = view.place[:, 0] / depth, view.place[:, 1] / depth
    v = safe.u / depth[:, None]
    d0 = _dot(v, v)
    p11, p12, p22 = (_dot(*pair) / d0 for pair in ((safe.a, safe.a), (safe.a, safe.b), (safe.b, safe.b)))
    # det of the precision as a triple product, which does not cancel: a x b = (u . (vx x vy)) u
    volume = torch.where(seen, _dot(view.a, view.vy), 1.0)
    det = torch.where(seen, (depth * volume) ** 2 / d0, 1.0)
    c11, c12, c22 = p22 / det, -p12 / det, p11 / det
    det_wide = 1 / det + box * (c11 + c22) + box * box
    w11, w12 = (c22 + box) / det_wide, -c12 / det_wide
    mass = _lattice_mass(x, y, c11 + box, c12, c22 + box) if box >= NARROWEST else torch.ones_like(x)
    amplitude = torch.sqrt(2 * math.pi / (d0 * det * det_wide)) / mass
    if projector.affine:
        bends = [torch.zeros_like(x)] * 5
        amplitude = amplitude * view.offset.norm(dim=1) / depth
    else:
        bends = [2 * _dot(v, view.vx), 2 * _dot(v, view.vy), _dot(view.vx, view.vx)]
        bends = [bend / d0 for bend in (*bends, 2 * _dot(view.vx, view.vy), _dot(view.vy, view.vy))]
    root = torch.sqrt(w11)
    numbers = torch.stack([x, y, root, w12 / root, 1 / torch.sqrt(c22 + box), *bends, amplitude], 1)
    numbers = torch.where(seen[:, None], numbers, 0.0)
    with torch.no_grad():
        bounds = _bounds(numbers, seen, panel, projector.cutoff)
    return ExactFootprints(numbers, bounds), near


def near_images(
    gaussians: tuple[Float[Tensor, "gaussian 3"], Float[Tensor, "gaussian 3 3"], Float[Tensor, "gaussian basis"]],
    frame: Float[Tensor, "4 3"],
    panel: tuple[int, int],
    projector: Projector,
) -> Float[Tensor, "basis row column"]:
    """Sum Gaussians near an end of the rays, without |d|, by the formula of `recon.ops.rasterize.near_field`.

    Parameters
    ----------
    gaussians : centres [mm], whitening matrices [1/mm], coefficients
    frame : source, d0, column step and row step [mm]
    panel : rows and columns
    projector : how Gaussians are projected

    Returns
    -------
    image of each basis
    """
    centres, matrices, coefficients = gaussians
    view, _ = _in_view(centres, matrices, frame)
    box, depth, square = projector.box, view.place[:, 2], _dot(view.u, view.u).clamp(min=TINY)
    jacobian = torch.stack([view.a, view.b], -1)
    one = torch.eye(3, dtype=square.dtype, device=square.device)
    c = (box * depth**2 / square)[:, None, None]
    wide = one + c * (jacobian @ jacobian.mT)
    amplitude = torch.sqrt(2 * math.pi / torch.linalg.det(wide))
    if box >= NARROWEST:
        volume = depth * _dot(view.a, view.vy)
        some = volume != 0
        scale = 1 / torch.where(some, volume, 1.0) ** 2
        x, y = (torch.where(some, view.place[:, i], 0.0) / torch.where(some, depth, 1.0) for i in (0, 1))
        entries = (_dot(*pair) * scale for pair in ((view.b, view.b), (view.a, view.b), (view.a, view.a)))
        c11, c12, c22 = entries
        mass = _lattice_mass(x, y, c11 + box, -c12, c22 + box)
        amplitude = amplitude / torch.where(some, mass, 1.0)
    column, row = (torch.arange(n, dtype=depth.dtype, device=depth.device) for n in (panel[1], panel[0]))
    directions = frame[1] + column[:, None] * frame[2] + row[:, None, None] * frame[3]
    v = torch.einsum("nij,rcj->nrci", matrices, directions)
    u = view.u[:, None, None].expand_as(v)
    m, length = torch.linalg.cross(u, v), v.norm(dim=-1)
    smooth = torch.einsum("nij,nrcj->nrci", torch.linalg.inv(wide), m)
    q = _dot(m, smooth) / length**2
    shift = -c[..., None] * torch.einsum("nij,nrci->nrcj", jacobian, smooth)
    seen = v + shift[..., :1] * view.vx[:, None, None] + shift[..., 1:] * view.vy[:, None, None]
    end = seen.norm(dim=-1)
    z = _dot(u, seen) / end
    part = (torch.erf(z * math.sqrt(0.5)) + torch.erf((end - z) * math.sqrt(0.5))) / 2
    value = amplitude[:, None, None] / length * torch.exp(-q / 2) * part
    value = torch.where(q < projector.cutoff**2, value, 0.0)
    return torch.einsum("nrc,nm->mrc", value, coefficients)


def _places(view: _View, matrices: Tensor, inverse: Tensor, projector: Projector) -> tuple[Tensor, Tensor]:
    """Decide which Gaussians lie between source and panel, and which near one of them; see `near_field.classify`."""
    with torch.no_grad():
        depth, k2 = view.place[:, 2], projector.cutoff**2
        if projector.affine:
            return (depth > 0) & (depth < 1), torch.empty(0, dtype=torch.int64, device=depth.device)
        square, norms = REACH**2 + k2, (matrices * matrices).sum(-1)
        distance = torch.sqrt(square * ((matrices @ inverse[2]) ** 2 / norms**2).sum(-1))
        q11 = _dot(view.a, view.a) - k2 * _dot(view.vx, view.vx)
        q12 = _dot(view.a, view.b) - k2 * _dot(view.vx, view.vy)
        q22 = _dot(view.b, view.b) - k2 * _dot(view.vy, view.vy)
        ellipse = (q11 > 0) & (q11 * q22 > q12 * q12) & (_dot(view.u, view.u) >= square)
        between = (distance < depth) & (depth < 1 - distance)
        hidden = ~((-distance < depth) & (depth < 1 + distance))
        near = ~between & ~hidden & ((depth > 1 - distance) | ~ellipse)
        return ~hidden & ~near & (depth > 0), torch.nonzero(near)[:, 0]


def _bounds(numbers: Tensor, seen: Tensor, panel: tuple[int, int], cutoff: float) -> Float[Tensor, "gaussian 4"]:
    """Bound the rows and columns of each footprint; all of them where its shadow is no ellipse."""
    x, y, l11, l21, l22, e1, e2, e3, e4, e5, _ = numbers.unbind(1)
    k2 = cutoff**2
    q11, q12, q22 = l11 * l11 - k2 * e3, l11 * l21 - k2 * e4 / 2, l21 * l21 + l22 * l22 - k2 * e5
    det = q11 * q22 - q12 * q12
    ellipse = (q11 > 0) & (det > 0)
    det = torch.where(ellipse, det, 1.0)
    square = k2 + k2 * k2 / 4 * (q22 * e1 * e1 - 2 * q12 * e1 * e2 + q11 * e2 * e2) / det
    ends = []
    for centre, shift, spread, size in (
        (y, q11 * e2 - q12 * e1, q11, panel[0]),
        (x, q22 * e1 - q12 * e2, q22, panel[1]),
    ):
        middle, half = centre + k2 / 2 * shift / det, torch.sqrt((square * spread / det).clamp(min=0))
        low = torch.where(ellipse, torch.ceil(middle - half), 0.0).clamp(0, size)
        high = torch.where(ellipse, torch.floor(middle + half) + 1, float(size)).clamp(0, size)
        ends += [low, torch.where(seen, torch.maximum(low, high), low)]
    return torch.stack(ends, 1)


def _lattice_mass(x: Tensor, y: Tensor, c11: Tensor, c12: Tensor, c22: Tensor) -> Tensor:
    """Sum footprints of unit mass over all pixels; see `footprint_table.lattice_mass`."""
    total = torch.ones_like(x)
    for i, j in ((1, 0), (-1, 1), (0, 1), (1, 1)):
        decay = torch.exp(-2 * math.pi**2 * (i * i * c11 + 2 * i * j * c12 + j * j * c22))
        total = total + 2 * decay * torch.cos(2 * math.pi * (i * x + j * y))
    return total


def _dot(a: Tensor, b: Tensor) -> Tensor:
    return (a * b).sum(-1)


def _axis(like: Tensor, number: int) -> Tensor:
    """Return unit vectors along one axis, as many as `like` holds."""
    axis = torch.zeros_like(like)
    axis[..., number] = 1.0
    return axis
