"""The likelihood of counts as a function of voxels: value, gradient, curvature, and the noise of its gradient."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.ops.project import project, project_transpose
from recon.data.measurements import Measurements
from recon.data.volume_edges import relative_density
from recon.ops.likelihood import MeasuredCounts, likelihood
from recon.ops.nonnegative_newton import as_matrices

VIEWS_AT_ONCE = 16  # bounds what is kept of projections

Volumes = Float[np.ndarray, "basis z y x"]


def deviance_and_gradient(
    volumes: Volumes, measurements: Measurements, grid: Grid, dispersion: float
) -> tuple[float, Volumes]:
    """Deviance of the counts of some views, and the gradient of half of it.

    Parameters
    ----------
    volumes : coefficients [1/mm]
    measurements : views that count
    grid : grid of `volumes`
    dispersion : relative model error; the variance is Y + (dispersion Y)^2
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
    """Separable majoriser of half the deviance, and the covariance of its gradient in a voxel that attenuates.

    With a_ri the length of ray r in voxel i, F_r the Fisher matrix of the ray's line integrals and s_i the pace of
    voxel i, its block is sum_r a_ri (sum_j a_rj s_j) F_r / s_i: steps by its inverse descend and do not depend on the
    basis.
    Voxels that are denser than most go faster, in proportion, or else small pieces of metal would be the last to
    converge. Where counts are noisy, the gradient of voxel i has the covariance sum_r a_ri^2 F_r; what comes back is
    its mean over voxels, each weighted by its attenuation. Along a ray, the sum of a_ri^2 is taken to be in proportion
    to that of a_ri.

    Returns
    -------
    blocks, upper triangles row by row; covariance

    References
    ----------
    Weidinger et al. 2016, doi:10.1155/2016/5871604; Mechlem et al. 2018, doi:10.1109/TMI.2017.2726687. Paces: Kim et
    al. 2013, doi:10.1109/TMI.2013.2266898.
    """
    bases = len(volumes)
    blocks = np.zeros((bases * (bases + 1) // 2, *grid.shape), np.float32)
    paces = np.maximum(relative_density(volumes), 1)
    probes = np.ones((3, *grid.shape), np.float32)
    probes[1] -= 2 * np.random.default_rng(0).integers(0, 2, grid.shape)
    probes[2] = paces
    whole = squares = 0.0
    weighted = np.zeros(len(blocks))
    empty = not volumes.any()
    for some in _portions(measurements):
        lengths, (through, signs, paced) = (forward(v, some.geometry, grid) for v in (volumes, probes))
        _, _, fisher = _likelihood(lengths, some, dispersion, True)
        blocks += transpose(fisher * paced, some.geometry, grid)
        weighted += np.einsum("pvrc,vrc->p", fisher, through if empty else lengths.sum(axis=0), dtype=np.float64)
        whole, squares = whole + through.sum(dtype=np.float64), squares + np.square(signs).sum(dtype=np.float64)
    attenuation = float(np.prod(grid.shape)) if empty else volumes.sum(dtype=np.float64)
    return blocks / paces, as_matrices(weighted * squares / (max(whole, 1e-30) * attenuation))


def forward(volumes: Volumes, geometry: Geometry, grid: Grid) -> Float[np.ndarray, "basis view row column"]:
    """Line integrals of every basis [no unit]."""
    panel = geometry.panel
    return project(volumes, grid, geometry.ray_frames(), panel.rows, panel.columns)


def transpose(images: Float[np.ndarray, "basis view row column"], geometry: Geometry, grid: Grid) -> Volumes:
    """Transpose of `forward` [mm]."""
    return project_transpose(images, grid, geometry.ray_frames())


def _portions(measurements: Measurements) -> Iterator[Measurements]:
    for first in range(0, len(measurements), VIEWS_AT_ONCE):
        yield measurements[slice(first, first + VIEWS_AT_ONCE)]


def _likelihood(
    lengths: Float[np.ndarray, "basis view row column"], data: Measurements, dispersion: float, information: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    counts = MeasuredCounts(data.counts, data.gains, data.exposure, data.profile, data.shares)
    deviances, gradient, fisher = likelihood(lengths, counts, data.transmission, dispersion, information)
    return deviances, gradient, np.zeros(0) if fisher is None else fisher
