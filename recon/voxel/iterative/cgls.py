"""Conjugate gradients for least squares, min ||w^1/2 (A x - b)||, each basis by itself.

Hestenes & Stiefel 1952, doi:10.6028/jres.049.044, in the form of Bjorck 1996, doi:10.1137/1.9781611971484, algorithm
7.4.1. Noise grows with iterations, so their number is what regularizes.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from recon.voxel.method import Images, Iteration, OnIteration, Volumes, Weights, unwatched
from recon.voxel.projector_pair import Pair


@dataclass(frozen=True)
class Cgls:
    """CGLS as a method; parameters as of `cgls`."""

    iterations: int = 12

    @property
    def name(self) -> str:
        """What ``--method`` calls it."""
        return "cgls"

    def reconstruct(
        self,
        line_integrals: Images,
        weights: Weights | None,
        geometry: Geometry,
        grid: Grid,
        on_iteration: OnIteration = unwatched,
    ) -> Volumes:
        """See `recon.voxel.method.LinearMethod`."""
        return cgls(line_integrals, geometry, grid, self.iterations, weights, on_iteration)


def cgls(
    line_integrals: Images,
    geometry: Geometry,
    grid: Grid,
    iterations: int = 12,
    weights: Weights | None = None,
    on_iteration: OnIteration = unwatched,
) -> Volumes:
    """Volumes [1/mm] of line integrals [no unit], from zero.

    Parameters
    ----------
    line_integrals : one image per basis and view
    geometry : any poses
    grid : the volume to reconstruct
    iterations : passes over all views
    weights : how much each ray counts; all alike if None
    on_iteration : called after every iteration; the residual is ||w^1/2 (b - A x)|| over ||w^1/2 b||

    Raises
    ------
    GeometryError
        When no ray meets the grid.
    """
    pair = Pair(geometry, grid)
    root = np.float32(1) if weights is None else np.sqrt(weights).astype(np.float32)
    volumes = np.zeros((len(line_integrals), *grid.shape), np.float32)
    left = (line_integrals * root).astype(np.float32)
    whole = _squares(left).sum()
    slope = pair.transpose(left * root)
    direction, steepness = slope.copy(), _squares(slope)
    for done in range(1, iterations + 1):
        image = pair.project(direction) * root
        step = _ratio(steepness, _squares(image))
        volumes += step * direction
        left -= step * image
        slope = pair.transpose(left * root)
        before, steepness = steepness, _squares(slope)
        direction *= _ratio(steepness, before)
        direction += slope
        residual = float(np.sqrt(_squares(left).sum() / whole)) if whole > 0 else 0.0
        on_iteration(Iteration(done, iterations, residual, volumes))
    return volumes


def _squares(arrays: Float[np.ndarray, "basis a b c"]) -> Float[np.ndarray, " basis"]:
    """Sum of squares of each basis, in float64."""
    return np.array([np.sum(np.square(array, dtype=np.float64)) for array in arrays])


def _ratio(a: Float[np.ndarray, " basis"], b: Float[np.ndarray, " basis"]) -> Float[np.ndarray, "basis 1 1 1"]:
    """One number per basis; 0 where there is nothing left to do."""
    return np.divide(a, b, out=np.zeros_like(a), where=b > 0).astype(np.float32)[:, None, None, None]
