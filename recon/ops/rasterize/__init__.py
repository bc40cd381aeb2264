"""Rasterize: exact line integrals of Gaussians along the rays of a panel."""

from jaxtyping import Float
from torch import Tensor

from phantomgen.geometry.curved_panel import join_modules
from recon.ops.arguments import GaussianTensors, check_shapes
from recon.ops.cpu_function import apply_on_cpu, on_gpu
from recon.ops.rasterize.cpu_calls import RasterizeCall
from recon.ops.rasterize.projector import CUTOFF, EXACT, FARTHEST, PROJECTORS, Projector, cutoff_for

__all__ = ["CUTOFF", "FARTHEST", "PROJECTORS", "Projector", "cutoff_for", "rasterize"]


def rasterize(
    centres: Float[Tensor, "gaussian 3"],
    log_scales: Float[Tensor, "gaussian 3"],
    quaternions: Float[Tensor, "gaussian 4"],
    coefficients: Float[Tensor, "gaussian basis"],
    frames: Float[Tensor, "view *module 4 3"],
    rows: int,
    columns: int,
    projector: Projector = EXACT,
) -> Float[Tensor, "view basis row column"]:
    """Compute the line integral of each basis along the ray through each pixel.

    Differentiable in the first four arguments.

    Parameters
    ----------
    centres : centres of the Gaussians [mm]
    log_scales : logarithm of the standard deviations along the principal axes [log mm]
    quaternions : orientation (w, x, y, z); normalised here
    coefficients : value at the centre per basis [1/mm]
    frames : per view source, d0, column step and row step [mm], by `phantomgen.geometry.poses.Geometry.ray_frames`;
        poses are arbitrary, and the source may be as far as 1e9 mm; or (view, module, 4, 3) of modules side by side
    rows, columns : size of the panel
    projector : over which area a pixel averages, where Gaussians end, and which formula holds

    Returns
    -------
    line integrals from source to panel, dimensionless, on the device of the Gaussians. Local-affine ones run over the
    whole line, and leave out Gaussians whose centre does not lie between source and panel.

    Raises
    ------
    InputError
        When shapes disagree.

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
    if frames.ndim == 4:
        modules, flat = frames.shape[1], frames.reshape(-1, 4, 3)
        parts = centres, log_scales, quaternions, coefficients
        return join_modules(rasterize(*parts, flat, rows, columns // modules, projector), modules)
    check_shapes(
        "rasterize", centres=centres, log_scales=log_scales, quaternions=quaternions, coefficients=coefficients
    )
    gaussians = GaussianTensors(centres, log_scales, quaternions, coefficients)
    if on_gpu(centres):
        from recon.ops.rasterize.gpu_calls import rasterize_on_gpu  # noqa: PLC0415 - Triton only where there is a GPU

        return rasterize_on_gpu(gaussians, frames, (rows, columns), projector)
    return apply_on_cpu(lambda parts: RasterizeCall(parts, frames, (rows, columns), projector), gaussians)
