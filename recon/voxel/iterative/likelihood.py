"""The likelihood of counts as a function of voxels: value, gradient, curvature, and the noise of the gradient."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from phantomgen.geometry.curved_panel import module_frames
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.ops.project import project, project_transpose
from recon.data.measurements import Measurements
from recon.ops.likelihood import MeasuredCounts, likelihood, tensors
from recon.ops.nonnegative_newton import as_matrices
from recon.voxel.method import Volumes

VIEWS_AT_ONCE = 16  # views; projected together, which bounds the memory


def deviance_and_gradient(volumes: Any, measurements: Measurements, grid: Grid, dispersion: float) -> tuple[float, Any]:
    """Compute the deviance of the counts of some views, and the gradient of half of it.

    Parameters
    ----------
    volumes : coefficients, `Volumes` or a tensor, on whose device all is computed [1/mm]
    measurements : the views
    grid : grid of `volumes`
    dispersion : relative model error [no unit]; the variance of counts Y is Y + (dispersion Y)^2

    Returns
    -------
    deviance [no unit]; gradient of half of it in the coefficients, of the kind of `volumes` [mm]
    """
    total, gradient = 0.0, torch.zeros_like(volumes) if isinstance(volumes, Tensor) else np.zeros_like(volumes)
    for some in _portions(measurements):
        deviances, ray_gradients, _ = _likelihood(forward(volumes, some.geometry, grid), some, dispersion, False)
        total += float(deviances.sum())
        gradient += transpose(ray_gradients, some.geometry, grid)
    return total, gradient


def curvature(
    volumes: Volumes,
    measurements: Measurements,
    grid: Grid,
    dispersion: float,
    step_scales: Float[np.ndarray, "z y x"] | None = None,
    device: str = "cpu",
) -> tuple[Float[np.ndarray, "pair z y x"], Float[np.ndarray, "basis basis"]]:
    """Compute a separable majoriser of half the deviance, and the covariance of its gradient in an attenuating voxel.

    With a_ri the length of ray r in voxel i, F_r the Fisher matrix of the line integrals of the ray and s_i the step
    scale of voxel i, the block of voxel i is sum_r a_ri (sum_j a_rj s_j) F_r / s_i: steps by its inverse reduce the
    deviance and do not depend on the choice of the basis. This holds for any positive step scales; voxels with larger
    ones than the others along their rays take longer steps.

    Noise of the counts gives the gradient of voxel i the covariance sum_r a_ri^2 F_r. The function returns its mean
    over voxels, each weighted by its attenuation. Along a ray, the sum of a_ri^2 is assumed proportional to that of
    a_ri.

    Parameters
    ----------
    volumes : coefficients [1/mm]
    measurements : the views
    grid : grid of `volumes`
    dispersion : relative model error [no unit]; the variance of counts Y is Y + (dispersion Y)^2
    step_scales : s, positive; None for 1 everywhere
    device : where rays are computed, ``cpu`` or ``cuda``

    Returns
    -------
    block of each voxel, upper triangle row by row [mm^2]; covariance [mm^2]

    References
    ----------
    Weidinger et al. 2016, doi:10.1155/2016/5871604; Mechlem et al. 2018, doi:10.1109/TMI.2017.2726687. Step scales: Kim
    et al. 2013, doi:10.1109/TMI.2013.2266898.
    """
    probes = np.ones((3, *grid.shape), np.float32)
    probes[1] -= 2 * np.random.default_rng(0).integers(0, 2, grid.shape)
    if step_scales is not None:
        probes[2] = step_scales
    scan = volumes, probes, measurements, grid, dispersion
    sums = _sums(*scan) if device == "cpu" else _sums_on_device(*scan, device)
    attenuation = volumes.sum(dtype=np.float64) if volumes.any() else float(np.prod(grid.shape))
    covariance = as_matrices(sums.weighted * sums.squares / (max(sums.whole, 1e-30) * attenuation))
    return sums.blocks / probes[2], covariance


class _Sums(NamedTuple):
    """Sums over rays: blocks of the voxels; curvatures times attenuation; paths; squares of random sums of voxels."""

    blocks: Float[np.ndarray, "pair z y x"]
    weighted: Float[np.ndarray, " pair"]
    whole: float
    squares: float


def _sums(
    volumes: Volumes,
    probes: Float[np.ndarray, "probe z y x"],
    measurements: Measurements,
    grid: Grid,
    dispersion: float,
) -> _Sums:
    """Compute the sums of `curvature` by the processor."""
    bases, empty, whole, squares = len(volumes), not volumes.any(), 0.0, 0.0
    blocks = np.zeros((bases * (bases + 1) // 2, *grid.shape), np.float32)
    weighted = np.zeros(len(blocks))
    for some in _portions(measurements):
        lengths, (through, signs, scaled) = (forward(v, some.geometry, grid) for v in (volumes, probes))
        _, _, fisher = _likelihood(lengths, some, dispersion, True)
        blocks += transpose(fisher * scaled, some.geometry, grid)
        weighted += np.einsum("pvrc,vrc->p", fisher, through if empty else lengths.sum(axis=0), dtype=np.float64)
        whole, squares = whole + through.sum(dtype=np.float64), squares + np.square(signs).sum(dtype=np.float64)
    return _Sums(blocks, weighted, whole, squares)


def _sums_on_device(
    volumes: Volumes,
    probes: Float[np.ndarray, "probe z y x"],
    measurements: Measurements,
    grid: Grid,
    dispersion: float,
    device: str,
) -> _Sums:
    """Compute the sums of `curvature` on a device of torch."""
    bases, empty, whole, squares = len(volumes), not volumes.any(), 0.0, 0.0
    values, tests = (torch.from_numpy(part).to(device) for part in (volumes, probes))
    blocks = values.new_zeros(bases * (bases + 1) // 2, *grid.shape)
    weighted = torch.zeros(len(blocks), dtype=torch.float64, device=device)
    for some in _portions(measurements):
        lengths, (through, signs, scaled) = (forward(v, some.geometry, grid) for v in (values, tests))
        _, _, fisher = _likelihood(lengths, some, dispersion, True)
        blocks += transpose(fisher * scaled, some.geometry, grid)
        along = through if empty else lengths.sum(dim=0)
        weighted += torch.einsum("pvrc,vrc->p", fisher.double(), along.double())
        whole, squares = whole + float(through.double().sum()), squares + float(signs.double().square().sum())
    return _Sums(blocks.cpu().numpy(), weighted.cpu().numpy(), whole, squares)


def forward(volumes: Any, geometry: Geometry, grid: Grid) -> Any:
    """Compute the line integrals of every basis.

    Parameters
    ----------
    volumes : coefficients, an array or a tensor [1/mm]
    geometry : poses of the views
    grid : grid of `volumes`

    Returns
    -------
    one image per basis and view, of the same kind [no unit]
    """
    panel = geometry.panel
    return project(volumes, grid, module_frames(geometry), panel.rows, panel.columns)


def transpose(images: Any, geometry: Geometry, grid: Grid) -> Any:
    """Apply the transpose of `forward`.

    Parameters
    ----------
    images : one image per basis and view
    geometry : poses of the views
    grid : grid of the result

    Returns
    -------
    one volume per basis, an array or a tensor as the images are, in units of the images times mm
    """
    return project_transpose(images, grid, module_frames(geometry))


def _portions(measurements: Measurements) -> Iterator[Measurements]:
    for first in range(0, len(measurements), VIEWS_AT_ONCE):
        yield measurements[slice(first, first + VIEWS_AT_ONCE)]


def _likelihood(lengths: Any, data: Measurements, dispersion: float, information: bool) -> tuple[Any, Any, Any]:
    """Compute deviances, gradient and curvatures, arrays or tensors as the line integrals are."""
    counts = MeasuredCounts(data.counts, data.gains, data.exposure, data.profile, data.statistical_weights)
    if isinstance(lengths, Tensor):
        return tensors.likelihood(lengths, counts, data.transmission, dispersion, information)
    return likelihood(lengths, counts, data.transmission, dispersion, information)
