"""Methods that fit primitives to the images of each channel or basis, and compute their volume."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Bool, Float

from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from recon.published_methods.paper.initialize import first_gaussians, units_of
from recon.published_methods.splatting.primitives import VolumePrimitives
from recon.published_methods.splatting.training import Splatting, Training, seen_rays, train
from recon.voxel.initial_volumes import initial_volumes, starting_method
from recon.voxel.method import Images, Iteration, OnIteration, Volumes, Weights, no_callback
from spectra.threads import without_other_pools


@dataclass(frozen=True)
class VolumeSplatting(Splatting):
    """A method that fits primitives of attenuation, as a `recon.voxel.method.LinearMethod`."""

    primitives: ClassVar[VolumePrimitives]

    @without_other_pools()
    def reconstruct(
        self,
        line_integrals: Images,
        weights: Weights | None,
        geometry: Geometry,
        grid: Grid,
        on_iteration: OnIteration = no_callback,
    ) -> Volumes:
        """Reconstruct volumes from line integrals, with first primitives at voxels of a first reconstruction.

        Parameters
        ----------
        line_integrals : one image per channel or basis and view [no unit]
        weights : 0 for rays that were not measured; all others have equal statistical weight
        geometry : poses of the views
        grid : grid of the volume
        on_iteration : called every few steps

        Returns
        -------
        volumes [1/mm]; zeros where the first reconstruction is nowhere positive
        """
        seen, recipe = seen_rays(line_integrals, weights), self.recipe
        starts = first_volumes(line_integrals, seen, geometry, grid)
        trainings = [
            self._begin(start, images, seen, geometry, grid)
            for start, images in zip(starts, line_integrals, strict=True)
        ]

        def volumes() -> Float[np.ndarray, "basis z y x"]:
            nothing = np.zeros(grid.shape, np.float32)
            return np.stack(
                [nothing if t is None else self.primitives.volume(t.model, t.units, grid) for t in trainings]
            )

        def report(step: int, residual: float) -> None:
            on_iteration(Iteration(step, recipe.steps, residual, volumes()))

        train(trainings, len(geometry), recipe, report)
        return volumes()

    def _begin(
        self,
        start: Float[np.ndarray, "z y x"],
        images: Float[np.ndarray, "view row column"],
        seen: Bool[np.ndarray, "view row column"],
        geometry: Geometry,
        grid: Grid,
    ) -> Training | None:
        """Primitives at the voxels of a first volume; None where it is nowhere positive."""
        if not (start > 0).any():
            return None
        recipe = self.recipe
        units = units_of(start, grid, recipe)
        model = first_gaussians(start, grid, np.ones(1), units, recipe)
        return Training(model, self.primitives, images, seen, geometry, grid, units, recipe)


def first_volumes(
    images: Images, seen: Bool[np.ndarray, "view row column"], geometry: Geometry, grid: Grid
) -> Float[np.ndarray, "basis z y x"]:
    """Reconstruct the first volumes, by filtered back-projection or, for orbits that need it, three sweeps of SART.

    Parameters
    ----------
    images : one image per channel or basis and view [no unit]
    seen : rays that were measured
    geometry : poses of the views
    grid : grid of the volume

    Returns
    -------
    volumes [1/mm]
    """
    method = starting_method(geometry, grid)
    return initial_volumes(np.moveaxis(images, 0, 1), np.all(~seen, axis=0), geometry, grid, method)
