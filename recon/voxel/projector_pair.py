"""The projector pair of one scan: line integrals of volumes, and the transpose, for some of the views."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.ops.project import project, project_transpose
from recon.voxel.method import Images, Volumes, Weights
from spectra.errors import GeometryError

_EVERY = slice(None)
Views = slice | np.ndarray


@dataclass(frozen=True, eq=False)
class Pair:
    """Matched projector pair between a grid and the views of a geometry, any flat panel in any pose.

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
    def frames(self) -> Float[np.ndarray, "view 4 3"]:
        """Rays of all views."""
        return self.geometry.ray_frames()

    @cached_property
    def lengths(self) -> Weights:
        """Path length of every ray in the grid, the sum of its row of the matrix [mm]."""
        return self.project(np.ones((1, *self.grid.shape), np.float32))[0]

    def project(self, volumes: Volumes, views: Views = _EVERY) -> Images:
        """Line integrals of volumes [1/mm] in some of the views."""
        panel = self.geometry.panel
        return project(volumes, self.grid, self.frames[views], panel.rows, panel.columns)

    def transpose(self, images: Images, views: Views = _EVERY) -> Volumes:
        """Transpose of `project`."""
        return project_transpose(images, self.grid, self.frames[views])

    def row_scales(self, weights: Weights | None) -> Weights:
        """One over the path length of each ray, times its weight; 0 for rays that hardly touch the grid."""
        longest = float(self.lengths.max())
        met = self.lengths > 0.01 * longest
        scales = np.divide(1.0, self.lengths, out=np.zeros_like(self.lengths), where=met)
        return scales if weights is None else (scales * weights).astype(np.float32)


def inverse_or_zero(sums: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """One over sums of weights that cannot be negative; 0 where they are next to nothing."""
    return np.divide(1.0, sums, out=np.zeros_like(sums), where=sums > 1e-3 * sums.max(initial=0.0))
