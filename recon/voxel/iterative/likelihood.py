"""The likelihood of counts as a function of voxels: value, gradient, curvature, and the noise of the gradient."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from phantomgen.geometry.curved_panel import module_frames
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.ops.project import project, project_transpose
from recon.data.measurements import Measurements
from recon.data.volume_edges import relative_density
from recon.ops.likelihood import MeasuredCounts, likelihood
from recon.ops.nonnegative_newton import as_matrices
from recon.voxel.method import Images, Volumes

VIEWS_AT_ONCE = 16  # views; projected together, which bounds the memory


def deviance_and_gradient(
    volumes: Volumes, measurements: Measurements, grid: Grid, dispersion: float
) -> tuple[float, Volumes]:
    """Compute the deviance of the counts of some views, and the gradient of half of it.

    Parameters
    ----------
    volumes : coefficients [1/mm]
    measurements : the views
    grid : grid of `volumes`
    dispersion : relative model error [no unit]; the variance of counts Y is Y + (dispersion Y)^2

    Returns
    -------
    deviance [no unit]; gradient of half of it in the coefficients [mm]
    """
    total, gradient = 0.0, np.zeros_like(volumes, dtype=np.float32)
    for some in _portions(measurements):
        deviances, ray_gradients, _ = _likelihood(forward(volumes, some.geometry, grid), some, dispersion, False)
        total += float(deviances.sum())
        gradient += transpose(ray_gradients, some.geometry, grid)
    return total, gradient


def curvature(
    volumes: Volumes, measurements: Measurements, grid: Grid, dispersion: float
) -> tuple[Float[np.ndarray, "pair z y x"], Float[np.ndarray, "basis basis"]]:
    """Compute a separable majoriser of half the deviance, and the covariance of its gradient in an attenuating voxel.

    With a_ri the length of ray r in voxel i, F_r the Fisher matrix of the line integrals of the ray and s_i the step
    scale of voxel i, the block of voxel i is sum_r a_ri (sum_j a_rj s_j) F_r / s_i: steps by its inverse reduce the
    deviance and do not depend on the choice of the basis. Step scales are larger, in proportion, for voxels denser than
    the typical one; otherwise small pieces of metal would be the last to converge.

    Noise of the counts gives the gradient of voxel i the covariance sum_r a_ri^2 F_r. The function returns its mean
    over voxels, each weighted by its attenuation. Along a ray, the sum of a_ri^2 is assumed proportional to that of
    a_ri.

    Parameters
    ----------
    volumes : coefficients [1/mm]
    measurements : the views
    grid : grid of `volumes`
    dispersion : relative model error [no unit]; the variance of counts Y is Y + (dispersion Y)^2

    Returns
    -------
    block of each voxel, upper triangle row by row [mm^2]; covariance [mm^2]

    References
    ----------
    Weidinger et al. 2016, doi:10.1155/2016/5871604; Mechlem et al. 2018, doi:10.1109/TMI.2017.2726687. Step scales: Kim
    et al. 2013, doi:10.1109/TMI.2013.2266898.
    """
    bases = len(volumes)
    blocks = np.zeros((bases * (bases + 1) // 2, *grid.shape), np.float32)
    step_scales = np.maximum(relative_density(volumes), 1)
    probes = np.ones((3, *grid.shape), np.float32)
    probes[1] -= 2 * np.random.default_rng(0).integers(0, 2, grid.shape)
    probes[2] = step_scales
    whole = squares = 0.0
    weighted = np.zeros(len(blocks))
    empty = not volumes.any()
    for some in _portions(measurements):
        lengths, (through, signs, scaled) = (forward(v, some.geometry, grid) for v in (volumes, probes))
        _, _, fisher = _likelihood(lengths, some, dispersion, True)
        blocks += transpose(fisher * scaled, some.geometry, grid)
        weighted += np.einsum("pvrc,vrc->p", fisher, through if empty else lengths.sum(axis=0), dtype=np.float64)
        whole, squares = whole + through.sum(dtype=np.float64), squares + np.square(signs).sum(dtype=np.float64)
    attenuation = float(np.prod(grid.shape)) if empty else volumes.sum(dtype=np.float64)
    return blocks / step_scales, as_matrices(weighted * squares / (max(whole, 1e-30) * attenuation))


def forward(volumes: Volumes, geometry: Geometry, grid: Grid) -> Images:
    """Compute the line integrals of every basis.

    Parameters
    ----------
    volumes : coefficients [1/mm]
    geometry : poses of the views
    grid : grid of `volumes`

    Returns
    -------
    one image per basis and view [no unit]
    """
    panel = geometry.panel
    return project(volumes, grid, module_frames(geometry), panel.rows, panel.columns)


def transpose(images: Images, geometry: Geometry, grid: Grid) -> Volumes:
    """Apply the transpose of `forward`.

    Parameters
    ----------
    images : one image per basis and view
    geometry : poses of the views
    grid : grid of the result

    Returns
    -------
    one volume per basis, in units of the images times mm
    """
    return project_transpose(images, grid, module_frames(geometry))


def _portions(measurements: Measurements) -> Iterator[Measurements]:
    for first in range(0, len(measurements), VIEWS_AT_ONCE):
        yield measurements[slice(first, first + VIEWS_AT_ONCE)]


def _likelihood(
    lengths: Images, data: Measurements, dispersion: float, information: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    counts = MeasuredCounts(data.counts, data.gains, data.exposure, data.profile, data.statistical_weights)
    deviances, gradient, fisher = likelihood(lengths, counts, data.transmission, dispersion, information)
    return deviances, gradient, np.zeros(0) if fisher is None else fisher
