"""Chords: path lengths of rays in ellipsoids of constant attenuation, and such ellipsoids on a grid."""

import torch
from jaxtyping import Float
from torch import Tensor

from recon.ops.chords.kernel_calls import ChordScene, fill
from recon.ops.rasterize.cpu_calls import Settings
from spectra.errors import InputError

SMOOTH = 0.02  # 1 - q, with q the squared distance of a ray from the centre over the radius, below which chords bend

__all__ = ["SMOOTH", "chords", "fill"]


def chords(
    centres: Float[Tensor, "ellipsoid 3"],
    log_axes: Float[Tensor, "ellipsoid 3"],
    quaternions: Float[Tensor, "ellipsoid 4"],
    coefficients: Float[Tensor, "ellipsoid basis"],
    frames: Float[Tensor, "view 4 3"],
    rows: int,
    columns: int,
    smooth: float = SMOOTH,
) -> Float[Tensor, "view basis row column"]:
    """Line integrals of ellipsoids along the rays through pixel centres; differentiable in the first four arguments.

    Parameters
    ----------
    centres : centres of the ellipsoids [mm]
    log_axes : logarithm of the semi-axes [log mm]
    quaternions : orientation (w, x, y, z); normalised here
    coefficients : attenuation inside per basis [1/mm]; it adds up where ellipsoids overlap
    frames : per view source, d0, column step and row step [mm], as `phantomgen.geometry.poses.Geometry.ray_frames`
        gives
    rows, columns : size of the panel
    smooth : rays that pass the centre at more than sqrt(1 - smooth) radii get a shorter chord whose slope is finite

    Returns
    -------
    Line integrals, dimensionless. Ellipsoids that do not lie between source and panel as a whole are left out.

    Raises
    ------
    InputError
        When shapes disagree, or `smooth` is not between 0 and 1.

    Notes
    -----
    With u = A (p - o), v = A d and A = S^-1 R^T the chord is 2 |d| sqrt(t) / |v|, t = 1 - |u x v|^2 / |v|^2 > 0. Its
    slope is infinite at the outline, t = 0. Below t = smooth the root is replaced by a parabola through 0 that meets
    it with its value and slope: sqrt(smooth) (3 s - s^2) / 2 with s = t / smooth.
    """
    n = len(centres)
    for name, value, width in (
        ("centres", centres, 3),
        ("log_axes", log_axes, 3),
        ("quaternions", quaternions, 4),
        ("coefficients", coefficients, coefficients.shape[-1]),
    ):
        if tuple(value.shape) != (n, width):
            raise InputError(f"chords: {name} has shape {tuple(value.shape)}, expected ({n}, {width})")
    if not 0 < smooth < 1:
        raise InputError(f"chords: smooth must be between 0 and 1, got {smooth:g}")
    settings = Settings(rows, columns, 0.0, 1.0, False)
    return _Chords.apply(centres, log_axes, quaternions, coefficients, frames, settings, smooth)  # type: ignore[return-value]


class _Chords(torch.autograd.Function):
    @staticmethod
    def forward(ctx, centres, log_axes, quaternions, coefficients, frames, settings, smooth):
        parts = (centres, log_axes, quaternions, coefficients)
        ctx.scene, ctx.dtypes = ChordScene(parts, frames, settings, smooth), [part.dtype for part in parts]
        return torch.from_numpy(ctx.scene.images()).to(coefficients.dtype)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, *cotangents):
        gradients = zip(ctx.scene.gradients(cotangents[0]), ctx.dtypes, strict=True)
        return *(torch.from_numpy(g).to(dtype) for g, dtype in gradients), None, None, None
