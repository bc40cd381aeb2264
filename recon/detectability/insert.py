"""An insert: the round object whose detection is asked for, and the same volumes without it."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from recon.gaussians.model import GaussianModel
from recon.quality.region import ball, rod
from recon.voxel.model import Voxels
from spectra.errors import InputError

MARGIN = 1.5  # of the radius; blur carries an insert beyond its edge
RING = 2.0  # of the radius; outer radius of the surroundings
LEAST = 12  # voxels from the centre to the edge of images where there is room: the widest channel has a width of ten


@dataclass(frozen=True)
class Insert:
    """A ball, or a rod along z.

    Parameters
    ----------
    center : (x, y, z) [mm]
    radius : [mm]
    length : of a rod [mm]; None for a ball
    """

    center: tuple[float, float, float]
    radius: float
    length: float | None = None

    @classmethod
    def parse(cls, text: str) -> "Insert":
        """Read an insert as it is written on a command line.

        Parameters
        ----------
        text : ``X,Y,Z,RADIUS`` or ``X,Y,Z,RADIUS,LENGTH`` [mm]

        Returns
        -------
        the insert

        Raises
        ------
        InputError
            When it is not written so, or a size is not positive.
        """
        try:
            x, y, z, radius, *length = map(float, text.split(","))
        except ValueError:
            x = y = z = radius = np.nan
            length = []
        if len(length) > 1 or not np.isfinite([x, y, z]).all() or not all(0 < s < np.inf for s in (radius, *length)):
            raise InputError(
                f"an insert is X,Y,Z,RADIUS for a ball or X,Y,Z,RADIUS,LENGTH for a rod along z [mm], got {text!r}"
            )
        return cls((x, y, z), radius, *length)

    def __str__(self) -> str:
        return ",".join(f"{n:g}" for n in (*self.center, self.radius, *([] if self.length is None else [self.length])))

    def region(self, grid: Grid, scale: float = 1.0) -> Bool[np.ndarray, "z y x"]:
        """Mark the voxels of the insert.

        Parameters
        ----------
        grid : the voxels
        scale : factor of the radius

        Returns
        -------
        True inside
        """
        if self.length is None:
            return ball(grid, self.center, scale * self.radius)
        return rod(grid, self.center, scale * self.radius, self.length)

    def layers(self, grid: Grid) -> slice:
        """Return the axial slices through the insert: of a rod all, of a ball those within half the radius.

        Parameters
        ----------
        grid : the voxels

        Returns
        -------
        range of slices, at least one

        Raises
        ------
        InputError
            When the insert is not in the grid.
        """
        reach = (self.radius if self.length is None else self.length) / 2
        apart = np.abs(grid.axis("z") - self.center[2])
        near = np.flatnonzero(apart <= max(reach, apart.min()))
        if apart.min() > grid.spacing[0]:
            raise InputError(f"the insert at {self} mm lies outside of the volume")
        return slice(int(near[0]), int(near[-1]) + 1)

    def window(self, grid: Grid, scale: float = 3.0) -> tuple[slice, slice, tuple[float, float]]:
        """Return a square of voxels around the insert, for images of it.

        Parameters
        ----------
        grid : the voxels, as long along y as along x
        scale : distance of its edges from the centre over the radius, where the volume is so large

        Returns
        -------
        rows, columns, and the row and column of the centre in the square

        Raises
        ------
        InputError
            When less than `RING` radii around the insert are within the grid.
        """
        if not np.isclose(grid.spacing[1], grid.spacing[2]):
            raise InputError(f"observers need square voxels, got spacings of {grid.spacing[1:]} mm along y and x")
        pitch = grid.spacing[1]
        place = [(self.center[1 - i] - grid.origin[1 + i]) / pitch for i in range(2)]
        middle = [int(np.rint(p)) for p in place]
        room = min(min(m, n - 1 - m) for m, n in zip(middle, grid.shape[1:], strict=True))
        least = int(np.ceil(min(scale, RING) * self.radius / pitch))
        if room < least:
            raise InputError(
                f"the insert at {self} mm needs {least * pitch:.4g} mm of volume around its centre along x and y: "
                "choose one further from the edge of the volume"
            )
        wanted = max(int(np.ceil(scale * self.radius / pitch)), LEAST if scale > RING else 1)
        half = min(wanted, room)
        rows, columns = (slice(m - half, m + half + 1) for m in middle)
        return rows, columns, (place[0] - middle[0] + half, place[1] - middle[1] + half)

    def excess(self, volumes: Float[np.ndarray, "basis z y x"], grid: Grid) -> Float[np.ndarray, "basis z y x"]:
        """Compute what the insert adds to its surroundings.

        Parameters
        ----------
        volumes : coefficients [1/mm]
        grid : the voxels

        Returns
        -------
        coefficients minus their mean in a ring around the insert; 0 outside of `MARGIN` radii [1/mm]

        Raises
        ------
        InputError
            When the insert or its ring has no voxel.
        """
        inside, outer = self.region(grid, MARGIN), self.region(grid, RING)
        ring = outer & ~inside
        if not inside.any() or not ring.any():
            raise InputError(f"the insert at {self} mm holds no voxel: the voxels are {max(grid.spacing):.4g} mm")
        level = volumes[:, ring].mean(axis=1, dtype=np.float64)
        return np.where(inside, volumes - level[:, None, None, None], 0.0).astype(np.float32)


@dataclass(frozen=True, eq=False)
class WithoutInsert:
    """A model from which an insert is taken away.

    Parameters
    ----------
    model : with the insert
    excess : what the insert adds to its surroundings
    """

    model: GaussianModel | Voxels
    excess: Voxels

    @property
    def basis_names(self) -> tuple[str, ...]:
        """Names of the bases."""
        return self.model.basis_names

    def line_integrals(self, geometry: Geometry) -> Float[Tensor, "view basis row column"]:
        """Compute the line integrals of each basis.

        Parameters
        ----------
        geometry : poses of the views

        Returns
        -------
        one image per view and basis [no unit]
        """
        with torch.no_grad():
            return self.model.line_integrals(geometry) - self.excess.line_integrals(geometry)
