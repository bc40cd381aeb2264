"""Rasterize: exact line integrals of Gaussians along the rays of a flat panel."""

from collections.abc import Callable

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from recon.ops.rasterize import cpu
from recon.ops.simd import WIDTH
from spectra.errors import InputError
from spectra.threads import run_parallel

CUTOFF = 3.7  # standard deviations; beyond it a footprint is below 1.1e-3 of its peak
CHUNK = 2048  # Gaussians per piece of work
BANDS = 4  # pieces of work that the rows of a view are shared between


def rasterize(
    centres: Float[Tensor, "gaussian 3"],
    log_scales: Float[Tensor, "gaussian 3"],
    quaternions: Float[Tensor, "gaussian 4"],
    coefficients: Float[Tensor, "gaussian basis"],
    frames: Float[Tensor, "view 4 3"],
    rows: int,
    columns: int,
    footprint: float = 1.0,
    cutoff: float = CUTOFF,
) -> Float[Tensor, "view basis row column"]:
    """Line integral of each basis along the ray through each pixel; differentiable in the first four arguments.

    Parameters
    ----------
    centres : centres of the Gaussians [mm]
    log_scales : logarithm of the standard deviations along the principal axes [log mm]
    quaternions : orientation (w, x, y, z); normalised here
    coefficients : value at the centre per basis [1/mm]
    frames : per view source, d0, column step and row step [mm], as `phantomgen.geometry.Geometry.ray_frames` gives
    rows, columns : size of the panel
    footprint : edge of the square that a pixel averages over, in pixels; 0 samples the pixel centre
    cutoff : where a footprint ends, in standard deviations

    Returns
    -------
    Line integrals, dimensionless. The integral runs over the whole line; Gaussians whose centre does not lie between
    source and panel are left out.

    Raises
    ------
    InputError
        When shapes disagree.

    References
    ----------
    The line integral of a Gaussian in whitened coordinates (u = A (p - o), v = A d) is
    |d| sqrt(2 pi) / |v| exp(-|u x v|^2 / (2 |v|^2)); exact for any cone angle, offset, tilt and pose.
    """
    n = len(centres)
    for name, value, width in (
        ("centres", centres, 3),
        ("log_scales", log_scales, 3),
        ("quaternions", quaternions, 4),
        ("coefficients", coefficients, coefficients.shape[-1]),
    ):
        if tuple(value.shape) != (n, width):
            raise InputError(f"rasterize: {name} has shape {tuple(value.shape)}, expected ({n}, {width})")
    return _Rasterize.apply(centres, log_scales, quaternions, coefficients, frames, rows, columns, footprint, cutoff)  # type: ignore[return-value]


class _Rasterize(torch.autograd.Function):
    @staticmethod
    def forward(ctx, centres, log_scales, quaternions, coefficients, frames, rows, columns, footprint, cutoff):
        scene = _Scene(centres, log_scales, quaternions, coefficients, frames, rows, columns, footprint, cutoff)
        ctx.scene, ctx.dtype = scene, centres.dtype
        return torch.from_numpy(scene.images()).to(coefficients.dtype)

    @staticmethod
    def backward(ctx, *cotangents):
        gradients = ctx.scene.gradients(cotangents[0])
        return *(torch.from_numpy(g).to(ctx.dtype) for g in gradients), None, None, None, None, None


class _Scene:
    """Arrays of one call, as the kernels want them: geometry in float64, pixels in float32."""

    def __init__(self, centres, log_scales, quaternions, coefficients, frames, rows, columns, footprint, cutoff):
        self.centres, self.log_scales, self.quaternions, self.frames = (
            x.detach().cpu().numpy().astype(np.float64) for x in (centres, log_scales, quaternions, frames)
        )
        self.coefficients = coefficients.detach().cpu().numpy().astype(np.float32)
        self.rows, self.columns, self.cutoff, self.box = rows, columns, cutoff, footprint**2 / 12
        self.inverses = np.linalg.inv(np.stack([self.frames[:, 2], self.frames[:, 3], self.frames[:, 1]], axis=-1))
        self.lengths = [_ray_lengths(frame, rows, columns) for frame in self.frames]
        n, views = len(self.centres), len(self.frames)
        self.matrices = np.empty((n, 3, 3))
        self.tables = np.empty((views, n, cpu.FOOTPRINT_SIZE), np.float32)
        self._each_chunk(lambda a, b: cpu.whitening(self.log_scales, self.quaternions, a, b, self.matrices))

    def _each_chunk(self, task: Callable[[int, int], None]) -> None:
        n = len(self.centres)
        _run(lambda a: task(a, min(a + CHUNK, n)), range(0, n, CHUNK))

    def images(self) -> np.ndarray:
        """Line integrals (view, basis, row, column)."""
        views, bases = len(self.frames), self.coefficients.shape[1]
        image = np.zeros((views, bases, self.rows, self.columns + WIDTH), np.float32)
        box, cutoff = self.box, self.cutoff

        def project(piece: tuple[int, int]) -> None:
            view, a = piece
            b = min(a + CHUNK, len(self.centres))
            frame, inverse, table = self.frames[view], self.inverses[view], self.tables[view]
            cpu.footprints(self.centres, self.matrices, frame, inverse, box, cutoff, self.rows, a, b, table)

        def splat(piece: tuple[int, int]) -> None:
            view, band = piece
            a, b = (band * self.rows // BANDS, (band + 1) * self.rows // BANDS)
            table, lengths = self.tables[view], self.lengths[view]
            cpu.forward(table, self.coefficients, lengths, cutoff, self.columns, a, b, image[view])

        _run(project, [(view, a) for view in range(views) for a in range(0, len(self.centres), CHUNK)])
        _run(splat, [(view, band) for view in range(views) for band in range(BANDS)])
        return image[..., : self.columns]

    def gradients(self, cotangents: Tensor) -> tuple[np.ndarray, ...]:
        """Gradients with respect to centres, log-scales, quaternions and coefficients."""
        n, bases = self.coefficients.shape
        padded = np.zeros((*cotangents.shape[:3], self.columns + WIDTH), np.float32)
        padded[..., : self.columns] = cotangents.detach().cpu().numpy()
        for view, lengths in zip(padded, self.lengths, strict=True):
            view[..., : self.columns] *= lengths
        to_centres, to_matrices, to_coefficients = np.zeros((n, 3)), np.zeros((n, 3, 3)), np.zeros((n, bases))
        to_scales, to_quaternions = np.empty((n, 3)), np.empty((n, 4))

        def gather(a: int, b: int) -> None:
            cpu.backward(
                self.centres, self.matrices, self.coefficients, self.frames, self.inverses, self.tables, padded,
                self.box, self.cutoff, self.columns, a, b, to_centres, to_matrices, to_coefficients,
            )  # fmt: skip
            cpu.whitening_backward(
                self.log_scales, self.quaternions, self.matrices, to_matrices, a, b, to_scales, to_quaternions
            )

        self._each_chunk(gather)
        return to_centres, to_scales, to_quaternions, to_coefficients


def _run(task, pieces) -> None:
    for _ in run_parallel(task, pieces):
        pass


def _ray_lengths(frame: np.ndarray, rows: int, columns: int) -> np.ndarray:
    x, y = np.arange(columns)[None, :, None], np.arange(rows)[:, None, None]
    return np.linalg.norm(frame[1] + x * frame[2] + y * frame[3], axis=-1).astype(np.float32)
