"""Standard deviations over replicates: of each voxel, of quantities that follow from the bases, of means of regions."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import uniform_filter

from phantomgen.geometry.voxel_grid import Grid
from recon.readouts.quantity import Quantity, in_pieces
from recon.runs.read_run import read_volumes
from spectra.errors import DatasetError

NEIGHBOURS = 3  # voxels; edge of the cube over which variances of voxels are averaged, as few replicates scatter widely

Volumes = Float[np.ndarray, "basis z y x"]


@dataclass(frozen=True, eq=False)
class Spread:
    """Mean and standard deviation of a quantity over replicates.

    Parameters
    ----------
    mean : mean over the replicates
    deviation : standard deviation of a single reconstruction, its variance averaged over `NEIGHBOURS` voxels
    """

    mean: Float[np.ndarray, "..."]
    deviation: Float[np.ndarray, "..."]


@dataclass(frozen=True, eq=False)
class Replicates:
    """Volumes of reconstructions that differ by their noise alone.

    Parameters
    ----------
    paths : their files, at least two
    grid, basis_names : of all volumes
    """

    paths: tuple[Path, ...]
    grid: Grid
    basis_names: tuple[str, ...]

    @classmethod
    def read(cls, paths: Sequence[Path]) -> "Replicates":
        """Look at the files of replicates.

        Parameters
        ----------
        paths : the files

        Returns
        -------
        the replicates, whose volumes are read when they are needed

        Raises
        ------
        DatasetError
            When there are less than two, or they differ in grid or bases.
        """
        if len(paths) < 2:
            raise DatasetError(f"a standard deviation needs two replicates at least, got {len(paths)}")
        first = read_volumes(paths[0])
        return cls(tuple(paths), first.grid, first.basis_names)

    def __len__(self) -> int:
        return len(self.paths)

    @property
    def certainty(self) -> float:
        """Relative standard error of a standard deviation from so many normal numbers, of one voxel alone."""
        return 1 / np.sqrt(2 * (len(self) - 1))

    def each(self) -> Iterator[Volumes]:
        """Read the basis volumes of one replicate after another.

        Returns
        -------
        iterator over coefficients [1/mm]
        """
        return map(self._volumes, self.paths)

    def _volumes(self, path: Path) -> Volumes:
        stored = read_volumes(path)
        if stored.grid != self.grid or stored.basis_names != self.basis_names:
            raise DatasetError(f"{path} has another grid or other bases than {self.paths[0]}: remove its folder")
        return stored.values

    def spread(self, quantity: Callable[[Volumes], Float[np.ndarray, "..."]] = lambda volumes: volumes) -> Spread:
        """Compute mean and standard deviation of a quantity in every voxel.

        Parameters
        ----------
        quantity : function from basis volumes [1/mm] to one volume or several; the basis volumes themselves where it
            is left out

        Returns
        -------
        both of the shape that `quantity` returns; NaN where a replicate has no value

        Notes
        -----
        Sums of deviations from the first replicate are kept, so that one volume is in memory at a time.
        """
        first = np.asarray(quantity(self._volumes(self.paths[0])), np.float64)
        total, squares = np.zeros_like(first), np.zeros_like(first)
        for path in self.paths[1:]:
            difference = quantity(self._volumes(path)) - first
            total += difference
            squares += difference**2
        count = len(self)
        variance = np.maximum(squares - total**2 / count, 0.0) / (count - 1)
        smooth = uniform_filter(variance, NEIGHBOURS, mode="nearest", axes=(-3, -2, -1))
        return Spread(first + total / count, np.sqrt(np.maximum(smooth, 0.0)))

    def quantity(self, chosen: Quantity) -> Spread:
        """Compute mean and standard deviation of a physical quantity in every voxel.

        Parameters
        ----------
        chosen : the quantity, such as CT numbers

        Returns
        -------
        both in the unit of the quantity
        """
        return self.spread(lambda volumes: in_pieces(chosen, volumes))

    def region(
        self,
        inside: Bool[np.ndarray, "z y x"],
        quantity: Callable[[Volumes], Float[np.ndarray, "..."]] = lambda volumes: volumes,
    ) -> Spread:
        """Compute the mean of a quantity over a region, and its standard deviation.

        Neighbouring voxels have correlated noise, which this takes into account and voxel deviations cannot.

        Parameters
        ----------
        inside : voxels of the region
        quantity : function from basis volumes [1/mm] to one volume or several

        Returns
        -------
        mean over region and replicates, and standard deviation of the region's mean in a single reconstruction
        """
        means = np.array([np.asarray(quantity(self._volumes(path)))[..., inside].mean(axis=-1) for path in self.paths])
        return Spread(np.asarray(means.mean(axis=0)), np.asarray(means.std(axis=0, ddof=1)))
