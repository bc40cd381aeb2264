"""The likelihood of counts as a function of voxels: value, gradient, curvature, and the noise of the gradient."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from phantomgen.geometry.curved_panel import module_frames
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.ops.project import project, project_transpose
from recon.data.measurements import Measurements
from recon.data.volume_edges import relative_density
from recon.ops.likelihood import MeasuredCounts, likelihood, tensors
from recon.ops.nonnegative_newton import as_matrices
from recon.voxel.method import Volumes

VIEWS_AT_ONCE = 16  # views; projected together, which bounds the memory


class Curvature(NamedTuple):
    """Second derivatives of half the deviance.

    Parameters
    ----------
    blocks : separable majoriser, one block per voxel, upper triangle row by row [mm^2]
    covariance : of the gradient in an attenuating voxel, by the noise of the counts [mm^2]
    information : diagonals of the blocks if all voxels are expected to change alike [mm^2]
    """

    blocks: Float[np.ndarray, "pair z y x"]
    covariance: Float[np.ndarray, "basis basis"]
    information: Float[np.ndarray, "basis z y x"]


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
        deviances, ray_gradients, *_ = _likelihood(forward(volumes, some.geometry, grid), some, dispersion, False)
        total += float(deviances.sum())
        gradient += transpose(ray_gradients, some.geometry, grid)
    return total, gradient


def curvature(
    volumes: Volumes,
    measurements: Measurements,
    grid: Grid,
    dispersion: float,
    changes: Float[np.ndarray, "z y x"] | None = None,
    device: str = "cpu",
) -> Curvature:
    """Compute a separable majoriser of half the deviance, and the covariance of its gradient in an attenuating voxel.

    With a_ri the length of ray r in voxel i, F_r the Fisher matrix of the line integrals of the ray and s_i the step
    scale of voxel i, the block of voxel i is sum_r a_ri (sum_j a_rj s_j) F_r / s_i: steps by its inverse reduce the
    deviance and do not depend on the choice of the basis. Where fewer counts arrive than expected, F_r includes the
    curvature of the expected counts: two broad spectra tell photoelectric from Compton attenuation by so little that
    steps without it overshoot and diverge. This holds for any positive step scales; voxels with larger ones than the
    others along their rays take longer steps. Step scales are the changes that are expected, times the density of
    voxels denser than the typical one; otherwise small pieces of metal would be the last to converge.

    Noise of the counts gives the gradient of voxel i the covariance sum_r a_ri^2 F_r. The function returns its mean
    over voxels, each weighted by its attenuation. Along a ray, the sum of a_ri^2 is assumed proportional to that of
    a_ri.

    Parameters
    ----------
    volumes : coefficients [1/mm]
    measurements : the views
    grid : grid of `volumes`
    dispersion : relative model error [no unit]; the variance of counts Y is Y + (dispersion Y)^2
    changes : expected change of each voxel relative to the others, positive; None for the same everywhere
    device : where rays are computed, ``cpu`` or ``cuda``

    Returns
    -------
    blocks, covariance, and the diagonals of the blocks with equal changes

    References
    ----------
    Weidinger et al. 2016, doi:10.1155/2016/5871604; Mechlem et al. 2018, doi:10.1109/TMI.2017.2726687. Step scales: Kim
    et al. 2013, doi:10.1109/TMI.2013.2266898.
    """
    probes = np.ones((3 if changes is None else 4, *grid.shape), np.float32)
    probes[1] -= 2 * np.random.default_rng(0).integers(0, 2, grid.shape)
    probes[2:] = np.maximum(relative_density(volumes), 1)
    if changes is not None:
        probes[2] *= changes
    scan = volumes, probes, measurements, grid, dispersion
    sums = _sums(*scan) if device == "cpu" else _sums_on_device(*scan, device)
    attenuation = volumes.sum(dtype=np.float64) if volumes.any() else float(np.prod(grid.shape))
    covariance = as_matrices(sums.weighted * sums.squares / (max(sums.whole, 1e-30) * attenuation))
    blocks = sums.blocks / probes[2]
    return Curvature(blocks, covariance, blocks[_own(len(volumes))] if changes is None else sums.even / probes[3])


def _own(bases: int) -> Int[np.ndarray, " basis"]:
    """Pairs of a basis with itself among the pairs of the upper triangle."""
    rows, columns = np.triu_indices(bases)
    return np.flatnonzero(rows == columns)


class _Sums(NamedTuple):
    """Sums over rays.

    They are blocks of the voxels, and with equal changes their diagonals; curvatures times attenuation; paths; squares
    of random sums of voxels.
    """

    blocks: Float[np.ndarray, "pair z y x"]
    even: Float[np.ndarray, "basis z y x"]
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
    weighted, even, own = np.zeros(len(blocks)), np.zeros((bases, *grid.shape), np.float32), _own(bases)
    for some in _portions(measurements):
        lengths, (through, signs, scaled, *plain) = (forward(v, some.geometry, grid) for v in (volumes, probes))
        _, _, fisher, residual = _likelihood(lengths, some, dispersion, True)
        blocks += transpose((fisher + residual) * scaled, some.geometry, grid)
        if plain:
            even += transpose(fisher[own] * plain[0], some.geometry, grid)
        weighted += np.einsum("pvrc,vrc->p", fisher, through if empty else lengths.sum(axis=0), dtype=np.float64)
        whole, squares = whole + through.sum(dtype=np.float64), squares + np.square(signs).sum(dtype=np.float64)
    return _Sums(blocks, even, weighted, whole, squares)


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
    even, own = values.new_zeros(bases, *grid.shape), torch.from_numpy(_own(bases)).to(device)
    for some in _portions(measurements):
        lengths, (through, signs, scaled, *plain) = (forward(v, some.geometry, grid) for v in (values, tests))
        _, _, fisher, residual = _likelihood(lengths, some, dispersion, True)
        blocks += transpose((fisher + residual) * scaled, some.geometry, grid)
        if plain:
            even += transpose(fisher[own] * plain[0], some.geometry, grid)
        along = through if empty else lengths.sum(dim=0)
        weighted += torch.einsum("pvrc,vrc->p", fisher.double(), along.double())
        whole, squares = whole + float(through.double().sum()), squares + float(signs.double().square().sum())
    return _Sums(blocks.cpu().numpy(), even.cpu().numpy(), weighted.cpu().numpy(), whole, squares)


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


def _likelihood(lengths: Any, data: Measurements, dispersion: float, information: bool) -> tuple[Any, Any, Any, Any]:
    """Compute deviances, gradient and both curvatures, arrays or tensors as the line integrals are."""
    counts = MeasuredCounts(data.counts, data.gains, data.exposure, data.profile, data.statistical_weights)
    if isinstance(lengths, Tensor):
        return tensors.likelihood(lengths, counts, data.transmission, dispersion, information)
    return likelihood(lengths, counts, data.transmission, dispersion, information)
