"""Chords: path lengths of rays in ellipsoids of constant attenuation, and such ellipsoids on a grid."""

from jaxtyping import Float
from torch import Tensor

from recon.ops.arguments import GaussianTensors, check_shapes
from recon.ops.chords.kernel_calls import ChordCall, fill
from recon.ops.cpu_function import apply_on_cpu
from spectra.errors import InputError

SMOOTH = 0.02  # of t = 1 - (distance of the ray from the centre / radius)^2; below it a parabola replaces the root

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
    """Compute line integrals of ellipsoids along the rays through pixel centres.

    Differentiable in the first four arguments.

    Parameters
    ----------
    centres : centres of the ellipsoids [mm]
    log_axes : logarithm of the semi-axes [log mm]
    quaternions : orientation (w, x, y, z); normalised here
    coefficients : attenuation inside per basis [1/mm]; it adds up where ellipsoids overlap
    frames : per view source, d0, column step and row step [mm], by `phantomgen.geometry.poses.Geometry.ray_frames`
    rows, columns : size of the panel
    smooth : rays that pass the centre at more than sqrt(1 - smooth) radii get a shorter chord whose slope is finite

    Returns
    -------
    line integrals, dimensionless; ellipsoids that do not lie as a whole between source and panel are left out

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
    check_shapes("chords", centres=centres, log_axes=log_axes, quaternions=quaternions, coefficients=coefficients)
    if not 0 < smooth < 1:
        raise InputError(f"chords: smooth must be between 0 and 1, got {smooth:g}")
    ellipsoids = GaussianTensors(centres, log_axes, quaternions, coefficients)
    return apply_on_cpu(lambda parts: ChordCall(parts, frames, (rows, columns), smooth), ellipsoids)
