"""Rasterize: exact line integrals of Gaussians along the rays of a flat panel."""

import math
from importlib.util import find_spec

import torch
from jaxtyping import Float
from torch import Tensor

from recon.ops.rasterize.cpu_calls import Scene, Settings
from spectra.errors import InputError

CUTOFF = 3.7  # standard deviations; beyond it a footprint is below 1.1e-3 of its peak
FARTHEST = 5.0  # largest cutoff that the kernels' exponential allows
PROJECTORS = ("exact", "local-affine")


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
    projector: str = "exact",
) -> Float[Tensor, "view basis row column"]:
    """Line integral of each basis along the ray through each pixel; differentiable in the first four arguments.

    Parameters
    ----------
    centres : centres of the Gaussians [mm]
    log_scales : logarithm of the standard deviations along the principal axes [log mm]
    quaternions : orientation (w, x, y, z); normalised here
    coefficients : value at the centre per basis [1/mm]
    frames : per view source, d0, column step and row step [mm], by `phantomgen.geometry.poses.Geometry.ray_frames`;
        any poses, a source as far as 1e9 mm included
    rows, columns : size of the panel
    footprint : edge of the square that a pixel averages over, in pixels; 0 samples the pixel centre
    cutoff : where a footprint ends, in standard deviations, at most 5; `cutoff_for` gives that of an error
    projector : ``exact``; or ``local-affine``, which takes rays near a Gaussian for parallel to the one through its
        centre, as splatting methods do, to compare with: errors are in ``benchmarks/results/gaussian_projector.txt``

    Returns
    -------
    Line integrals from source to panel, dimensionless, on the device of the Gaussians. The local-affine ones run over
    the whole line, and leave Gaussians out whose centre does not lie between source and panel.

    Raises
    ------
    InputError
        When shapes disagree, or a number or a name is not one of those above.

    Notes
    -----
    On the CPU a call takes, besides its tensors, 4 bytes per pixel, basis and view and some 200 per Gaussian; and for
    as many views at a time as fit into 256 MiB (one at least), 52 per Gaussian and view and 4 per pixel and view.
    Gradients take another 200 per Gaussian, and 4 per pixel, basis and view for as many views.

    References
    ----------
    The line integral of a Gaussian in whitened coordinates (u = A (p - o), v = A d) is
    |d| sqrt(2 pi) / |v| exp(-|u x v|^2 / (2 |v|^2)); exact for any cone angle, offset, tilt and pose. Local-affine:
    Zha et al. 2024, R2-Gaussian, arXiv:2405.20693.
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
    if not 0 < cutoff <= FARTHEST:
        raise InputError(
            f"rasterize: cutoff must be above 0 and at most {FARTHEST:g} standard deviations, got {cutoff:g}"
        )
    if projector not in PROJECTORS:
        raise InputError(f"rasterize: projector must be {' or '.join(PROJECTORS)}, got {projector}")
    settings = Settings(rows, columns, footprint, cutoff, projector == "local-affine")
    if centres.device.type == "cuda" and find_spec("triton") is not None:
        from recon.ops.rasterize.gpu_calls import rasterize_on_gpu  # noqa: PLC0415 - Triton only where there is a GPU

        return rasterize_on_gpu(centres, log_scales, quaternions, coefficients, frames, settings)
    return _Rasterize.apply(centres, log_scales, quaternions, coefficients, frames, settings)  # type: ignore[return-value]


def cutoff_for(error: float) -> float:
    """Cutoff in standard deviations at which a footprint has fallen to `error` of its peak.

    That is the largest error of truncation. It also is the part of a footprint's sum that is cut off, by which
    line integrals through many Gaussians are too small.

    Raises
    ------
    InputError
        When the error is not below 1, or below what the largest cutoff leaves, 3.7e-6.
    """
    least = math.exp(-(FARTHEST**2) / 2)
    if not least <= error < 1:
        raise InputError(f"error of truncation must be from {least:.2g} to below 1 of the peak, got {error:g}")
    return math.sqrt(-2 * math.log(error))


class _Rasterize(torch.autograd.Function):
    @staticmethod
    def forward(ctx, centres, log_scales, quaternions, coefficients, frames, settings):
        parts = (centres, log_scales, quaternions, coefficients)
        ctx.scene, ctx.dtypes = Scene(parts, frames, settings), [part.dtype for part in parts]
        ctx.device = centres.device
        return torch.from_numpy(ctx.scene.images()).to(device=ctx.device, dtype=coefficients.dtype)

    @staticmethod
    def backward(ctx, *cotangents):
        gradients = zip(ctx.scene.gradients(cotangents[0]), ctx.dtypes, strict=True)
        return *(torch.from_numpy(g).to(device=ctx.device, dtype=dtype) for g, dtype in gradients), None, None
