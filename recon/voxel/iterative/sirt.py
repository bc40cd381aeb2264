"""Simultaneous iterative reconstruction: gradient descent with row and column sums for scales.

With A the matrix of path lengths, R and C the inverses of its row and column sums, and w the weights of rays::

    x <- x + relaxation C A^T R w (b - A x)

Gilbert 1972, doi:10.1016/0022-5193(72)90180-4; in this form Gregor & Benson 2008, doi:10.1109/TMI.2008.923696.
"""

from dataclasses import dataclass

import numpy as np

from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from recon.voxel.method import Images, Iteration, OnIteration, Volumes, Weights, unwatched
from recon.voxel.projector_pair import Pair, inverse_or_zero


@dataclass(frozen=True)
class Sirt:
    """SIRT as a method; parameters as of `sirt`."""

    iterations: int = 80
    relaxation: float = 1.9
    non_negative: bool = True

    @property
    def name(self) -> str:
        """What ``--method`` calls it."""
        return "sirt"

    def reconstruct(
        self,
        line_integrals: Images,
        weights: Weights | None,
        geometry: Geometry,
        grid: Grid,
        on_iteration: OnIteration = unwatched,
    ) -> Volumes:
        """See `recon.voxel.method.LinearMethod`."""
        steps = self.iterations, self.relaxation, self.non_negative
        return sirt(line_integrals, geometry, grid, *steps, weights=weights, on_iteration=on_iteration)


def sirt(
    line_integrals: Images,
    geometry: Geometry,
    grid: Grid,
    iterations: int = 80,
    relaxation: float = 1.9,
    non_negative: bool = True,
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
    relaxation : size of a step; converges below 2, and fastest near it
    non_negative : project on what is not negative after each step
    weights : how much each ray counts, at most 1; all alike if None
    on_iteration : called after every iteration; the residual is ||R^1/2 (b - A x)|| before it, over that of x = 0

    Raises
    ------
    GeometryError
        When no ray meets the grid.
    """
    pair = Pair(geometry, grid)
    rows = pair.row_scales(weights)
    seen = (rows > 0).astype(np.float32) if weights is None else (weights * (rows > 0)).astype(np.float32)
    columns = relaxation * inverse_or_zero(pair.transpose(seen[None])[0])
    volumes = np.zeros((len(line_integrals), *grid.shape), np.float32)
    whole = weighted_norm(line_integrals, rows)
    for done in range(1, iterations + 1):
        left = line_integrals - pair.project(volumes)
        residual = weighted_norm(left, rows) / whole
        volumes += columns * pair.transpose(left * rows)
        if non_negative:
            np.maximum(volumes, 0, out=volumes)
        on_iteration(Iteration(done, iterations, residual, volumes))
    return volumes


def weighted_norm(images: Images, weights: Weights) -> float:
    """Root of the weighted sum of squares; the smallest number above 0 where that is 0, to divide by."""
    total = sum(float(np.vdot(weights, image * image)) for image in images)
    return max(float(np.sqrt(total)), float(np.finfo(np.float32).tiny))
