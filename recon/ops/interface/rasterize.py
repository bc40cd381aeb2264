"""Images of divided Gaussians, differentiable."""

import numpy as np
import torch
from jaxtyping import Float, Int64
from torch import Tensor

from phantomgen.ops.simd import WIDTH as LANES
from recon.ops.interface import cpu
from recon.ops.interface.arrays import DividedTensors
from recon.ops.interface.footprints import footprints
from recon.ops.interface.sides import side_moments
from recon.ops.interface.table import SUMS
from recon.ops.pieces import run_all
from recon.ops.rasterize.footprints import near_images, whitening
from recon.ops.rasterize.projector import Projector

LIGHTEST = 1e-6  # part of a Gaussian's mass; a side with less is not projected near the ends of rays
CHUNK = 256  # Gaussians per piece of work
BANDS = 4  # pieces of work that the rows of a view are shared between


def rasterize_divided(
    gaussians: DividedTensors,
    frames: Float[Tensor, "view 4 3"],
    panel: tuple[int, int],
    projector: Projector,
) -> Float[Tensor, "view basis row column"]:
    """Compute the line integral of each basis along the ray through each pixel.

    Parameters
    ----------
    gaussians : the Gaussians
    frames : rays of the views, by `phantomgen.geometry.poses.Geometry.ray_frames`
    panel : rows and columns
    projector : over which area a pixel averages, and where Gaussians end; the exact one

    Returns
    -------
    line integrals, dimensionless, float32, differentiable in all arrays of the Gaussians. Near the source and the
    panel, each side of a plane counts as a Gaussian of the same mass, centre and covariance.

    References
    ----------
    `recon.ops.interface.reference` has the formula and its source.
    """
    exact = gaussians.exact()
    seen, below, above = footprints(exact, frames.double(), panel, projector), gaussians.below, gaussians.above
    images: Tensor = _Images.apply(seen.numbers, seen.rows, below, above - below, frames, panel, projector)  # type: ignore[assignment]
    if not any(len(near) for near in seen.near):
        return images
    return images + _near_the_ends(exact, seen.near, frames.double(), panel, projector)


def _near_the_ends(
    gaussians: DividedTensors,
    near: tuple[Int64[Tensor, " near"], ...],
    frames: Float[Tensor, "view 4 3"],
    panel: tuple[int, int],
    projector: Projector,
) -> Float[Tensor, "view basis row column"]:
    """Sum Gaussians that come near the source or the panel, each side as a Gaussian of its moments."""
    images = []
    for frame, which in zip(frames, near, strict=True):
        some = DividedTensors(*(part[which] for part in gaussians))
        matrices, image = whitening(some.log_scales, some.quaternions), torch.zeros(some.below.shape[1], *panel)
        third = torch.linalg.inv(matrices)[:, :, 2]
        for above, values in ((False, some.below), (True, some.above)):
            mass, mean, spread = side_moments(some.planes[:, 0], above)
            own = torch.cat([matrices[:, :2], matrices[:, 2:] / spread[:, None, None]], dim=1)
            moved, scaled = some.centres + third * mean[:, None], values * (mass / spread)[:, None]
            heavy = mass > LIGHTEST
            image = image + near_images((moved[heavy], own[heavy], scaled[heavy]), frame, panel, projector).float()
        images.append(image * torch.from_numpy(_ray_lengths(frame[None], panel)[0]))
    return torch.stack(images)


class _Images(torch.autograd.Function):
    @staticmethod
    def forward(ctx, numbers, rows, below, step, frames, panel, projector):
        table = numbers.detach().float().contiguous().numpy()
        spans = rows.detach().long().contiguous().numpy()
        low, high = (part.detach().float().contiguous().numpy() for part in (below, step))
        lengths = _ray_lengths(frames, panel)
        bases = (0,) * low.shape[1]
        image = np.zeros((len(table), len(bases), panel[0], panel[1] + LANES), np.float32)

        def splat(piece: tuple[int, int]) -> None:
            view, band = piece
            first, last = band * panel[0] // BANDS, (band + 1) * panel[0] // BANDS
            cpu.forward(
                bases, table[view], spans[view], low, high, lengths[view], projector.cutoff, panel[1], first, last,
                image[view],
            )  # fmt: skip

        run_all(splat, [(view, band) for view in range(len(table)) for band in range(BANDS)])
        ctx.arrays, ctx.numbers = (table, spans, low, high, lengths), numbers.detach()
        ctx.panel, ctx.projector = panel, projector
        ctx.dtype = below.dtype
        return torch.from_numpy(image[..., : panel[1]])

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, *cotangents):
        (table, spans, low, high, lengths), panel, projector = ctx.arrays, ctx.panel, ctx.projector
        bases, images = (0,) * low.shape[1], cotangents[0].detach().numpy()
        n = len(low)
        sums, to_low, to_high = np.zeros((len(table), n, SUMS)), np.zeros(low.shape), np.zeros(low.shape)
        padded = np.zeros((*images.shape[:3], panel[1] + LANES), np.float32)
        np.multiply(images, lengths[:, None], out=padded[..., : panel[1]])

        def gather(first: int) -> None:
            last = min(first + CHUNK, n)
            for view in range(len(table)):
                cpu.backward(
                    bases, table[view], spans[view], low, high, padded[view], projector.cutoff, panel[1],
                    first, last, sums[view], to_low, to_high,
                )  # fmt: skip

        run_all(gather, range(0, n, CHUNK))
        to_numbers = _to_numbers(ctx.numbers, torch.from_numpy(sums))
        return (
            to_numbers,
            None,
            torch.from_numpy(to_low).to(ctx.dtype),
            torch.from_numpy(to_high).to(ctx.dtype),
            None,
            None,
            None,
        )


def _to_numbers(
    numbers: Float[Tensor, "view gaussian 21"], sums: Float[Tensor, "view gaussian 23"]
) -> Float[Tensor, "view gaussian 21"]:
    """Gradient in each number of a footprint from the sums over its pixels (see `recon.ops.interface.cpu.backward`)."""
    _, _, l11, l21, l22, e1, e2, e3, e4, e5, amplitude, _, q1, q2, q3, q4, q5, _, b1, b2, _ = numbers.unbind(-1)
    w, ax, ay, axx, axy, ayy, s0, sx, sy, sxx, sxy, syy, offset, t0, tx, ty, txx, txy, tyy, b, bx, by, width = (
        sums.unbind(-1)
    )
    along = l11 * ax + l21 * ay
    to_x = -2 * l11 * along - (e1 * s0 + 2 * e3 * sx + e4 * sy) - (q1 * t0 + 2 * q3 * tx + q4 * ty) - b1 * b
    to_y = (
        -2 * (l21 * along + l22 * l22 * ay)
        - (e2 * s0 + e4 * sx + 2 * e5 * sy)
        - (q2 * t0 + q4 * tx + 2 * q5 * ty)
        - b2 * b
    )
    to_l = [2 * (l11 * axx + l21 * axy), 2 * (l11 * axy + l21 * ayy), 2 * l22 * ayy]
    to_amplitude = w / torch.where(amplitude == 0, 1.0, amplitude)
    parts = [to_x, to_y, *to_l, sx, sy, sxx, sxy, syy, to_amplitude, offset, tx, ty, txx, txy, tyy, b, bx, by, width]
    return torch.stack(parts, -1)


def _ray_lengths(frames: Tensor, panel: tuple[int, int]) -> Float[np.ndarray, "view row column"]:
    """Length |d| of each ray from source to panel."""
    first, column_step, row_step = (frames[:, i].numpy()[:, None, None] for i in (1, 2, 3))
    x, y = np.arange(panel[1])[None, None, :, None], np.arange(panel[0])[None, :, None, None]
    return np.linalg.norm(first + x * column_step + y * row_step, axis=-1).astype(np.float32)
