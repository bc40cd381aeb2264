"""The matched projector pair of one scan: line integrals of volumes, and the transpose, for some of the views."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from phantomgen.geometry.curved_panel import module_frames
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.ops.project import project, project_transpose
from recon.voxel.method import Images, Volumes, Weights
from spectra.errors import GeometryError

_EVERY = slice(None)
_LEAST_PATH = 0.01  # part of the longest path; rays with a shorter one are left out; chosen by hand, not measured
_LEAST_SUM = 1e-3  # part of the largest sum; divisors below give 0; chosen by hand, not measured
Views = slice | np.ndarray


@dataclass(frozen=True, eq=False)
class ProjectorPair:
    """Matched projector pair between a grid and the views of a geometry, for any panel in any pose.

    Parameters
    ----------
    geometry : poses of the views
    grid : grid of the volumes

    Raises
    ------
    GeometryError
        When no ray meets the grid.
    """

    geometry: Geometry
    grid: Grid

    def __post_init__(self) -> None:
        if not self.lengths.any():
            raise GeometryError(
                f"no ray of the {len(self.geometry)} views meets the volume, whose first voxel is at "
                f"{self.grid.origin} mm (z, y, x): check the poses and the grid"
            )

    @cached_property
    def frames(self) -> Float[np.ndarray, "view module 4 3"]:
        """Source, first pixel and pixel steps of every module of the panel in every view [mm]."""
        return module_frames(self.geometry)

    @cached_property
    def lengths(self) -> Weights:
        """Path length of every ray in the grid, the sum of its row of the matrix [mm]."""
        return self.project(np.ones((1, *self.grid.shape), np.float32))[0]

    def project(self, volumes: Volumes, views: Views = _EVERY) -> Images:
        """Compute line integrals of volumes in some of the views.

        Parameters
        ----------
        volumes : one volume per basis [1/mm]
        views : indices of the views, all by default

        Returns
        -------
        one image per basis and view [no unit]
        """
        panel = self.geometry.panel
        return project(volumes, self.grid, self.frames[views], panel.rows, panel.columns)

    def transpose(self, images: Images, views: Views = _EVERY) -> Volumes:
        """Apply the transpose of `project`.

        Parameters
        ----------
        images : one image per basis and view
        views : indices of the views of the images, all by default

        Returns
        -------
        one volume per basis, in units of the images times mm
        """
        return project_transpose(images, self.grid, self.frames[views])

    def row_scales(self, weights: Weights | None) -> Weights:
        """Compute the weight of each ray over its path length in the grid.

        Parameters
        ----------
        weights : statistical weight of each ray; None if all rays have the weight 1

        Returns
        -------
        weight over path length [1/mm], 0 for rays that hardly touch the grid
        """
        longest = float(self.lengths.max())
        met = self.lengths > _LEAST_PATH * longest
        scales = np.divide(1.0, self.lengths, out=np.zeros_like(self.lengths), where=met)
        return scales if weights is None else (scales * weights).astype(np.float32)


def inverse_or_zero(sums: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """Invert sums of non-negative weights.

    Parameters
    ----------
    sums : sums of weights

    Returns
    -------
    one over the sums, 0 where they are below a thousandth of the largest
    """
    return np.divide(1.0, sums, out=np.zeros_like(sums), where=sums > _LEAST_SUM * sums.max(initial=0.0))
