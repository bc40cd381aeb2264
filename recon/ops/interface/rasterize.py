"""Images of divided Gaussians, differentiable."""

import numpy as np
import torch
from jaxtyping import Bool, Float, Float32
from torch import Tensor

from phantomgen.geometry.curved_panel import join_modules
from phantomgen.ops.simd import WIDTH as LANES
from recon.ops.arguments import RayFrame, inverse_frames
from recon.ops.cpu_function import apply_on_cpu, on_gpu
from recon.ops.interface import cpu, cpu_footprints
from recon.ops.interface.arrays import DividedTensors, Footprints, ShapeGradients, Shapes, SideGradients, Sides
from recon.ops.interface.sides import side_moments
from recon.ops.interface.table import NUMBERS, SUMS
from recon.ops.pieces import run_all, run_in_pieces
from recon.ops.rasterize.cpu import whitening, whitening_backward
from recon.ops.rasterize.footprints import near_images
from recon.ops.rasterize.footprints import whitening as whitening_matrices
from recon.ops.rasterize.projector import Projector

LIGHTEST = 1e-6  # part of a Gaussian's mass; a side with less is not projected near the ends of rays
CHUNK = 256  # Gaussians per piece of work
BANDS = 4  # pieces of work that the rows of a view are shared between


def rasterize_divided(
    gaussians: DividedTensors,
    frames: Float[Tensor, "view *module 4 3"],
    panel: tuple[int, int],
    projector: Projector,
) -> Float[Tensor, "view basis row column"]:
    """Compute the line integral of each basis along the ray through each pixel.

    Parameters
    ----------
    gaussians : the Gaussians
    frames : rays of the views, by `phantomgen.geometry.poses.Geometry.ray_frames`; or (view, module, 4, 3) of modules
        side by side
    panel : rows and columns
    projector : over which area a pixel averages, and where Gaussians end; the exact one

    Returns
    -------
    line integrals, dimensionless, in the type of the coefficients, differentiable in all arrays of the Gaussians. Near
    the source and the panel, each side of a plane counts as a Gaussian of the same mass, centre and covariance.

    References
    ----------
    `recon.ops.interface.reference` has the formula and its source.
    """
    if frames.ndim == 4:
        modules, flat, module = frames.shape[1], frames.reshape(-1, 4, 3), (panel[0], panel[1] // frames.shape[1])
        return join_modules(rasterize_divided(gaussians, flat, module, projector), modules)
    if on_gpu(gaussians.centres):
        from recon.ops.interface.gpu.calls import rasterize_on_gpu  # noqa: PLC0415 - Triton only where there is a GPU

        images, near = rasterize_on_gpu(gaussians, frames, panel, projector)
    else:
        call = _Call(gaussians, frames, panel, projector)
        images, near = apply_on_cpu(lambda _: call, gaussians), torch.from_numpy(call.near)
    return images + near_the_ends(gaussians, near, frames, panel, projector) if near.any() else images


def near_the_ends(
    gaussians: DividedTensors,
    near: Bool[Tensor, "view gaussian"],
    frames: Float[Tensor, "view 4 3"],
    panel: tuple[int, int],
    projector: Projector,
) -> Float[Tensor, "view basis row column"]:
    """Sum Gaussians that come near the source or the panel, each side as a Gaussian of its moments, by plain torch.

    Parameters
    ----------
    gaussians : all Gaussians
    near : which come near in each view
    frames, panel, projector : as in `rasterize_divided`

    Returns
    -------
    line integrals, float32
    """
    images, device = [], near.device
    lengths = torch.from_numpy(_ray_lengths(frames.cpu(), panel)).to(device)
    for frame, some_near, length in zip(frames.double().to(device), near, lengths, strict=True):
        some = DividedTensors(*(part[some_near] for part in gaussians.exact()))
        matrices = whitening_matrices(some.log_scales, some.quaternions)
        image = torch.zeros(some.below.shape[1], *panel, device=device)
        third = torch.linalg.inv(matrices)[:, :, 2]
        for above, values in ((False, some.below), (True, some.above)):
            mass, mean, spread = side_moments(some.planes[:, 0], above)
            own = torch.cat([matrices[:, :2], matrices[:, 2:] / spread[:, None, None]], dim=1)
            moved, scaled = some.centres + third * mean[:, None], values * (mass / spread)[:, None]
            heavy = mass > LIGHTEST
            image = image + near_images((moved[heavy], own[heavy], scaled[heavy]), frame, panel, projector).float()
        images.append(image * length)
    return torch.stack(images)


class _Call:
    """Arrays of one call: geometry in float64, footprints and pixels in float32."""

    def __init__(self, gaussians: DividedTensors, frames: Tensor, panel: tuple[int, int], projector: Projector) -> None:
        exact = [part.detach().numpy().astype(np.float64) for part in gaussians[:4]]
        centres, log_scales, self.quaternions, planes = exact
        below, above = gaussians.below.detach(), gaussians.above.detach()
        self.sides = Sides(*(part.float().contiguous().numpy() for part in (below, above - below)))
        self.bases, self.panel, self.sampling = (0,) * below.shape[1], panel, projector.sampling
        self.lengths = _ray_lengths(frames, panel)
        self.frames = frames.numpy().astype(np.float64)
        self.inverses = inverse_frames(self.frames)
        views, n = len(self.frames), len(centres)
        self.shapes = Shapes(centres, log_scales, np.empty((n, 3, 3)), planes)
        table, spans = np.empty((views, n, NUMBERS), np.float32), np.empty((views, n, 2), np.int64)
        self.footprints = [Footprints(*pair) for pair in zip(table, spans, strict=True)]
        self.near = np.empty((views, n), np.bool_)
        run_in_pieces(self._measure, n, CHUNK)

    def _measure(self, first: int, last: int) -> None:
        """Compute the footprints of some Gaussians in all views."""
        whitening(self.shapes.log_scales, self.quaternions, first, last, self.shapes.matrices)
        for frame, written, near in zip(self.views(), self.footprints, self.near, strict=True):
            cpu_footprints.footprints(self.shapes, frame, self.sampling, self.panel[0], (first, last), written, near)

    def views(self) -> list[RayFrame]:
        """Return the rays of each view."""
        return [RayFrame(*pair) for pair in zip(self.frames, self.inverses, strict=True)]

    def values(self) -> Float32[np.ndarray, "view basis row column"]:
        """Compute line integrals."""
        rows, columns = self.panel
        image = np.zeros((len(self.frames), len(self.bases), rows, columns + LANES), np.float32)

        def splat(piece: tuple[int, int]) -> None:
            view, band = piece
            part = band * rows // BANDS, (band + 1) * rows // BANDS
            cpu.forward(
                self.bases, self.footprints[view], self.sides, self.lengths[view], self.sampling.cutoff, columns, part,
                image[view],
            )  # fmt: skip

        run_all(splat, [(view, band) for view in range(len(self.frames)) for band in range(BANDS)])
        return image[..., :columns]

    def gradients(self, cotangent: Float[Tensor, "view basis row column"]) -> list[np.ndarray]:
        """Compute the gradients in the six arrays of the Gaussians from those in the line integrals."""
        (rows, columns), n, images = self.panel, len(self.shapes.centres), cotangent.detach().numpy()
        padded = np.zeros((*images.shape[:2], rows, columns + LANES), np.float32)
        np.multiply(images, self.lengths[:, None], out=padded[..., :columns])
        bases = (n, len(self.bases))
        to_sides = SideGradients(np.zeros((n, SUMS)), np.zeros(bases), np.zeros(bases))
        to_shapes = ShapeGradients(np.zeros((n, 3)), np.zeros((n, 3, 3)), np.zeros((n, 2)))
        to_log_scales, to_quaternions = np.empty((n, 3)), np.empty((n, 4))

        def gather(first: int, last: int) -> None:
            part, cutoff, box = (first, last), self.sampling.cutoff, self.sampling.box
            for frame, seen, image in zip(self.views(), self.footprints, padded, strict=True):
                cpu.backward(self.bases, seen, self.sides, image, cutoff, columns, part, to_sides)
                cpu_footprints.backward(self.shapes, frame, box, seen.spans, to_sides.sums, part, to_shapes)
            whitening_backward(
                self.shapes.log_scales, self.quaternions, self.shapes.matrices, to_shapes.matrices, first, last,
                to_log_scales, to_quaternions,
            )  # fmt: skip

        run_in_pieces(gather, n, CHUNK)
        both = [to_sides.below - to_sides.step, to_sides.step]
        return [to_shapes.centres, to_log_scales, to_quaternions, to_shapes.planes, *both]


def _ray_lengths(frames: Tensor, panel: tuple[int, int]) -> Float[np.ndarray, "view row column"]:
    """Length |d| of each ray from source to panel."""
    first, column_step, row_step = (frames[:, i].numpy()[:, None, None] for i in (1, 2, 3))
    x, y = np.arange(panel[1])[None, None, :, None], np.arange(panel[0])[None, :, None, None]
    return np.linalg.norm(first + x * column_step + y * row_step, axis=-1).astype(np.float32)
