"""Volumes as a model of a scan, with the interface of Gaussians, so that both are scored in the same way."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from scipy.ndimage import map_coordinates
from torch import Tensor

from phantomgen.geometry.curved_panel import module_frames
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.ops.project import project


@dataclass(frozen=True, eq=False)
class Voxels:
    """Volumes of all bases on one grid.

    Parameters
    ----------
    values : coefficients [1/mm]
    grid : grid of the values
    basis_names : names of the bases
    """

    values: Float[np.ndarray, "basis z y x"]
    grid: Grid
    basis_names: tuple[str, ...]

    def line_integrals(self, geometry: Geometry) -> Float[Tensor, "view basis row column"]:
        """Compute the line integrals of each basis.

        Parameters
        ----------
        geometry : poses of the views

        Returns
        -------
        one image per view and basis [no unit]
        """
        panel = geometry.panel
        images = project(self.values, self.grid, module_frames(geometry), panel.rows, panel.columns)
        return torch.from_numpy(np.moveaxis(images, 0, 1))

    def volume(self, grid: Grid) -> Float[np.ndarray, "basis z y x"]:
        """Interpolate the coefficients linearly on any grid.

        Parameters
        ----------
        grid : grid of the result

        Returns
        -------
        coefficients [1/mm], 0 outside of the model's own grid
        """
        if grid == self.grid:
            return self.values
        places = [
            (grid.axis(name) - origin) / spacing
            for name, origin, spacing in zip("zyx", self.grid.origin, self.grid.spacing, strict=True)
        ]
        points = np.meshgrid(*places, indexing="ij")
        return np.stack([map_coordinates(v, points, order=1, mode="grid-constant") for v in self.values])
