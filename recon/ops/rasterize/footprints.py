"""Footprints of all Gaussians in some views, by torch in float64, differentiable: the steps of `cpu.footprints`."""

import math
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from recon.ops.arguments import TINY
from recon.ops.rasterize.footprint_table import NARROWEST, Footprints
from recon.ops.rasterize.near_field import REACH
from recon.ops.rasterize.projector import Projector


class ExactFootprints(NamedTuple):
    """Footprints of all Gaussians in some views, in float64.

    Parameters
    ----------
    numbers : xc, yc, l11, l21, l22, e1 to e5, amplitude; as in `recon.ops.rasterize.cpu`
    bounds : first row, one past the last, first column, one past the last
    """

    numbers: Float[Tensor, "view gaussian 11"]
    bounds: Float[Tensor, "view gaussian 4"]

    def rounded(self) -> Footprints:
        """Round the footprints to the types of the kernels.

        Returns
        -------
        footprints in float32, bounds as 32-bit integers
        """
        return Footprints(self.numbers.detach().float().contiguous(), self.bounds.int().contiguous())

    def gradients(self, sums: Float[Tensor, "view gaussian 12"], affine: bool) -> Float[Tensor, "view gaussian 11"]:
        """Compute the gradients in the numbers from sums over pixels.

        Parameters
        ----------
        sums : as in `recon.ops.rasterize.cpu.backward`
        affine : whether the projection is local-affine

        Returns
        -------
        gradient in each number
        """
        _, _, l11, l21, l22, e1, e2, e3, e4, e5, amplitude = self.numbers.detach().unbind(-1)
        w, ax, ay, axx, axy, ayy, b, bx, by, bxx, bxy, byy = sums.unbind(-1)
        along = l11 * ax + l21 * ay
        bends = [torch.zeros_like(w)] * 5 if affine else [bx, by, bxx, bxy, byy]
        to_x = -2 * l11 * along - (e1 * b + 2 * e3 * bx + e4 * by)
        to_y = -2 * (l21 * along + l22 * l22 * ay) - (e2 * b + e4 * bx + 2 * e5 * by)
        to_l = [2 * (l11 * axx + l21 * axy), 2 * (l11 * axy + l21 * ayy), 2 * l22 * ayy]
        safe = torch.where(amplitude == 0, 1.0, amplitude)
        return torch.stack([to_x, to_y, *to_l, *bends, w / safe], -1)


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
    """Gaussians in whitened coordinates of some views: offset from the source, place, u, vx, vy, u x vx, u x vy."""

    offset: Tensor
    place: Tensor  # inverse frame times offset; the third is the depth
    u: Tensor
    vx: Tensor
    vy: Tensor
    a: Tensor
    b: Tensor


class PlacedGaussians(NamedTuple):
    """Gaussians as they lie in some views; those that are not seen have finite numbers without a meaning.

    Parameters
    ----------
    seen : whether a Gaussian has a footprint
    near : whether it comes near an end of the rays, and has none for that
    distance : from the source to the centre [mm]
    x, y : projected centre [pixels]
    depth : of the centre, 0 at the source and 1 at the panel
    u, vx, vy : offset of the centre from the source, column step and row step, whitened
    a, b : u x vx and u x vy
    volume : u x vx . vy
    """

    seen: Bool[Tensor, "view gaussian"]
    near: Bool[Tensor, "view gaussian"]
    distance: Float[Tensor, "view gaussian"]
    x: Float[Tensor, "view gaussian"]
    y: Float[Tensor, "view gaussian"]
    depth: Float[Tensor, "view gaussian"]
    u: Float[Tensor, "view gaussian 3"]
    vx: Float[Tensor, "view gaussian 3"]
    vy: Float[Tensor, "view gaussian 3"]
    a: Float[Tensor, "view gaussian 3"]
    b: Float[Tensor, "view gaussian 3"]
    volume: Float[Tensor, "view gaussian"]


def _in_views(centres: Tensor, matrices: Tensor, frames: Tensor) -> tuple[_View, Tensor]:
    """Whiten the Gaussians in some views; also returns the inverses of the frames."""
    inverses = torch.linalg.inv(torch.stack([frames[:, 2], frames[:, 3], frames[:, 1]], -1))
    offset = centres - frames[:, :1]
    u = torch.einsum("nij,vnj->vni", matrices, offset)
    vx, vy = (torch.einsum("nij,vj->vni", matrices, frames[:, i]) for i in (2, 3))
    a, b = torch.linalg.cross(u, vx), torch.linalg.cross(u, vy)
    return _View(offset, offset @ inverses.mT, u, vx, vy, a, b), inverses


def placed(
    centres: Float[Tensor, "gaussian 3"],
    matrices: Float[Tensor, "gaussian 3 3"],
    frames: Float[Tensor, "view 4 3"],
    projector: Projector,
) -> PlacedGaussians:
    """Find where Gaussians lie in some views.

    Parameters
    ----------
    centres : centres [mm]
    matrices : whitening matrices [1/mm]
    frames : per view source, d0, column step and row step [mm]
    projector : how Gaussians are projected

    Returns
    -------
    their places
    """
    view, inverses = _in_views(centres, matrices, frames)
    seen, near = _places(view, matrices.detach(), inverses, projector)
    # Gaussians that are not seen here get finite numbers: those of a Gaussian half way from the source to the panel.
    depth = torch.where(seen, view.place[..., 2], 0.5)
    others = torch.ones_like(view.u), _axis(view.a, 0), _axis(view.b, 1)
    pairs = zip((view.u, view.a, view.b), others, strict=True)
    u, a, b = (torch.where(seen[..., None], known, other) for known, other in pairs)
    volume = torch.where(seen, _dot(view.a, view.vy), 1.0)
    x, y = (view.place[..., i] / depth for i in (0, 1))
    return PlacedGaussians(seen, near, view.offset.norm(dim=-1), x, y, depth, u, view.vx, view.vy, a, b, volume)


def footprints(gaussians: PlacedGaussians, panel: tuple[int, int], projector: Projector) -> ExactFootprints:
    """Compute the footprints of Gaussians in some views.

    Parameters
    ----------
    gaussians : where they lie in these views
    panel : rows and columns
    projector : how Gaussians are projected

    Returns
    -------
    footprints; the bounds of Gaussians that are not seen are empty
    """
    seen, box, x, y, depth = gaussians.seen, projector.box, gaussians.x, gaussians.y, gaussians.depth
    vx, vy, a, b, v = gaussians.vx, gaussians.vy, gaussians.a, gaussians.b, gaussians.u / depth[..., None]
    d0 = _dot(v, v)
    p11, p12, p22 = (_dot(*pair) / d0 for pair in ((a, a), (a, b), (b, b)))
    # det of the precision as a triple product, which does not cancel: a x b = (u . (vx x vy)) u
    det = torch.where(seen, (depth * gaussians.volume) ** 2 / d0, 1.0)
    c11, c12, c22 = p22 / det, -p12 / det, p11 / det
    det_wide = 1 / det + box * (c11 + c22) + box * box
    w11, w12 = (c22 + box) / det_wide, -c12 / det_wide
    mass = _lattice_mass(x, y, c11 + box, c12, c22 + box) if box >= NARROWEST else torch.ones_like(x)
    amplitude = torch.sqrt(2 * math.pi / (d0 * det * det_wide)) / mass
    if projector.affine:
        bends = [torch.zeros_like(x)] * 5
        amplitude = amplitude * gaussians.distance / depth
    else:
        bends = [2 * _dot(v, vx), 2 * _dot(v, vy), _dot(vx, vx), 2 * _dot(vx, vy), _dot(vy, vy)]
        bends = [bend / d0 for bend in bends]
    root = torch.sqrt(w11)
    numbers = torch.stack([x, y, root, w12 / root, 1 / torch.sqrt(c22 + box), *bends, amplitude], -1)
    numbers = torch.where(seen[..., None], numbers, 0.0)
    with torch.no_grad():
        bounds = _bounds(numbers, seen, panel, projector.cutoff)
    return ExactFootprints(numbers, bounds)


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
    view = _View(*(part[0] for part in _in_views(centres, matrices, frame[None])[0]))
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


def _places(view: _View, matrices: Tensor, inverses: Tensor, projector: Projector) -> tuple[Tensor, Tensor]:
    """Decide which Gaussians lie between source and panel, and which near one of them; see `near_field.classify`."""
    with torch.no_grad():
        depth, k2 = view.place[..., 2], projector.cutoff**2
        if projector.affine:
            seen = (depth > 0) & (depth < 1)
            return seen, torch.zeros_like(seen)
        square, norms = REACH**2 + k2, (matrices * matrices).sum(-1)
        across = torch.einsum("nij,vj->vni", matrices, inverses[:, 2])
        distance = torch.sqrt(square * (across**2 / norms**2).sum(-1))
        q11 = _dot(view.a, view.a) - k2 * _dot(view.vx, view.vx)
        q12 = _dot(view.a, view.b) - k2 * _dot(view.vx, view.vy)
        q22 = _dot(view.b, view.b) - k2 * _dot(view.vy, view.vy)
        ellipse = (q11 > 0) & (q11 * q22 > q12 * q12) & (_dot(view.u, view.u) >= square)
        between = (distance < depth) & (depth < 1 - distance)
        hidden = ~((-distance < depth) & (depth < 1 + distance))
        near = ~between & ~hidden & ((depth > 1 - distance) | ~ellipse)
        return ~hidden & ~near & (depth > 0), near


def _bounds(numbers: Tensor, seen: Tensor, panel: tuple[int, int], cutoff: float) -> Float[Tensor, "view gaussian 4"]:
    """Bound the rows and columns of each footprint; all of them where its shadow is no ellipse."""
    x, y, l11, l21, l22, e1, e2, e3, e4, e5, _ = numbers.unbind(-1)
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
    return torch.stack(ends, -1)


def _lattice_mass(x: Tensor, y: Tensor, c11: Tensor, c12: Tensor, c22: Tensor) -> Tensor:
    """Sum footprints of unit mass over all pixels; see `footprint_table.lattice_mass`."""
    k = x.new_tensor([[1, 0], [-1, 1], [0, 1], [1, 1]])
    i, j = k.T
    exponents = torch.stack([c11, c12, c22], -1) @ torch.stack([i * i, 2 * i * j, j * j])
    waves = torch.exp(-2 * math.pi**2 * exponents) * torch.cos(2 * math.pi * (torch.stack([x, y], -1) @ k.T))
    return 1 + 2 * waves.sum(-1)


def _dot(a: Tensor, b: Tensor) -> Tensor:
    return (a * b).sum(-1)


def _axis(like: Tensor, number: int) -> Tensor:
    """Return unit vectors along one axis, as many as `like` holds."""
    axis = torch.zeros_like(like)
    axis[..., number] = 1.0
    return axis
