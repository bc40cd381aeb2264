"""The loop that SIRT, SART and CGLS share: passes over the views, bounds on the values, callbacks.

All three reduce the weighted residual of ``A x = b``, with A the matrix of path lengths of the rays in the voxels [mm],
x the volumes [1/mm] and b the line integrals. A method is its update rule; `IterativeMethod.reconstruct` does the rest.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from recon.voxel.method import Images, Iteration, OnIteration, Volumes, Weights, no_callback
from recon.voxel.projector_pair import ProjectorPair

# One pass over the views, by the volumes and the number of the pass from 1 on. It changes the volumes in place, by one
# or several updates, and yields after each of them the relative residual of the pass so far.
UpdateRule = Callable[[Volumes, int], Iterator[float]]


@dataclass(frozen=True, eq=False)
class LinearSystem:
    """Line integrals ``b = A x`` of one scan, with the weights of the rays.

    Parameters
    ----------
    line_integrals : b, one image per basis and view [no unit]
    weights : statistical weight w of each ray, at most 1; None if all rays have the weight 1
    projector : A and its transpose
    """

    line_integrals: Images
    weights: Weights | None
    projector: ProjectorPair

    @cached_property
    def row_scales(self) -> Weights:
        """Weight of each ray over its path length in the grid [1/mm]; 0 for rays that hardly touch the grid."""
        return self.projector.row_scales(self.weights)

    @cached_property
    def ray_weights(self) -> Weights:
        """Weight of each ray, 0 for rays that hardly touch the grid."""
        met = self.row_scales > 0
        return met.astype(np.float32) if self.weights is None else (self.weights * met).astype(np.float32)

    @cached_property
    def norm(self) -> float:
        """Norm of the line integrals in the metric of `row_scales`, which is the residual of empty volumes."""
        return weighted_norm(self.line_integrals, self.row_scales)


class IterativeMethod(ABC):
    """Least-squares reconstruction of each basis by itself, from empty volumes on.

    A subclass is a dataclass with `iterations`, the number of passes over the views, and, if it can keep volumes
    non-negative, `non_negative`.
    """

    iterations: int
    non_negative: bool = False

    @abstractmethod
    def update_rule(self, system: LinearSystem) -> UpdateRule:
        """Prepare the passes over the views.

        Parameters
        ----------
        system : line integrals to explain, with their weights and projector

        Returns
        -------
        what one pass does with the volumes
        """

    def reconstruct(
        self,
        line_integrals: Images,
        weights: Weights | None,
        geometry: Geometry,
        grid: Grid,
        on_iteration: OnIteration = no_callback,
    ) -> Volumes:
        """Reconstruct volumes from line integrals.

        Parameters
        ----------
        line_integrals : one image per basis and view [no unit]
        weights : statistical weight of each ray, from 0 to 1; None if all rays have the same
        geometry : poses of the views, on any orbit
        grid : the volume to reconstruct
        on_iteration : called after every pass over the views with the relative residual

        Returns
        -------
        volumes of the bases [1/mm]

        Raises
        ------
        GeometryError
            When no ray meets the grid.
        """
        update = self.update_rule(LinearSystem(line_integrals, weights, ProjectorPair(geometry, grid)))
        volumes = np.zeros((len(line_integrals), *grid.shape), np.float32)
        for done in range(1, self.iterations + 1):
            residual = None
            for relative in update(volumes, done):
                residual = relative
                if self.non_negative:
                    np.maximum(volumes, 0, out=volumes)
            on_iteration(Iteration(done, self.iterations, residual, volumes))
        return volumes


def weighted_norm(images: Images, weights: Weights) -> float:
    """Root of the weighted sum of squares of images.

    Parameters
    ----------
    images : one image per basis and view
    weights : weight of each ray

    Returns
    -------
    the norm, at least the smallest positive float32, so that it can be a divisor
    """
    total = sum(float(np.vdot(weights, image * image)) for image in images)
    return max(float(np.sqrt(total)), float(np.finfo(np.float32).tiny))
