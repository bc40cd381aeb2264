"""Voxel maps as operators take them: boxes of voxels, each of which holds a mixture of materials.

A map fills the local box -1 .. 1 of a row of `Solids`, x fastest. A voxel names a row of a table of mixtures: with
labels the table is short, with volume fractions each mixed voxel has a row of its own. The part that a mixture lacks to
1 belongs to no object.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int32, Int64

from spectra.errors import InputError


class VoxelMap(NamedTuple):
    """One map, whose mixtures consist of parts; `VoxelMaps.of` gets the material of each part.

    Parameters
    ----------
    cells : row of the table that each voxel holds
    mixtures : volume fraction of each part
    """

    cells: Int32[np.ndarray, "z y x"]
    mixtures: Float[np.ndarray, "mixture part"]

    @classmethod
    def of_labels(cls, labels: np.ndarray, values: Sequence[int]) -> "VoxelMap":
        """Create a map of labels; part i fills the voxels with ``values[i]``, all others are empty.

        Parameters
        ----------
        labels : label of each voxel (z, y, x)
        values : label of each part

        Returns
        -------
        the map
        """
        cells = np.zeros(labels.shape, dtype=np.int32)
        for i, value in enumerate(values):
            cells[labels == value] = i + 1
        return cls(cells, np.eye(len(values) + 1, len(values), -1))

    @classmethod
    def of_fractions(cls, fractions: Float[np.ndarray, "part z y x"]) -> "VoxelMap":
        """Create a map of volume fractions.

        Parameters
        ----------
        fractions : of several parts

        Returns
        -------
        the map
        """
        parts, pure = len(fractions), (fractions == 1).sum(axis=0) == 1
        cells = np.where(pure, fractions.argmax(axis=0) + 1, 0).astype(np.int32)
        mixed = ~pure & (fractions > 0).any(axis=0)
        cells[mixed] = np.arange(parts + 1, parts + 1 + int(mixed.sum()))
        return cls(cells, np.concatenate([np.eye(parts + 1, parts, -1), fractions[:, mixed].T.astype(np.float64)]))

    @property
    def filled_box(self) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, " 3"]]:
        """Lowest and highest corner (x, y, z), in the local box, of all voxels that are not empty."""
        solid = np.any(self.mixtures > 0, axis=1)[self.cells]
        ends = [np.flatnonzero(solid.any(axis=axes)) for axes in ((0, 1), (0, 2), (1, 2))]
        faces = np.array([(e[0], e[-1] + 1) if len(e) else (0, 0) for e in ends])
        low, high = 2 * faces.T / self.cells.shape[::-1] - 1
        return low, high

    def points(self, count: int, rng: np.random.Generator) -> Float[np.ndarray, "3 point"]:
        """Draw random points in voxels that are not empty.

        Parameters
        ----------
        count : number of points
        rng : source of random numbers

        Returns
        -------
        points (x, y, z) of the local box
        """
        solid = np.flatnonzero(np.any(self.mixtures > 0, axis=1)[self.cells])
        z, y, x = np.unravel_index(rng.choice(solid, count), self.cells.shape)
        counts = np.array(self.cells.shape[::-1])[:, None]
        return 2 * (np.stack([x, y, z]) + rng.random((3, count))) / counts - 1

    def at(self, local: Float[np.ndarray, "3 point"]) -> Float[np.ndarray, "point part"]:
        """Return the mixtures at points; 0 outside.

        Parameters
        ----------
        local : points (x, y, z) of the local box

        Returns
        -------
        volume fraction of each part
        """
        counts = np.array(self.cells.shape[::-1])[:, None]
        index = np.floor((local + 1) / 2 * counts).astype(np.int64)
        inside = np.all((index >= 0) & (index < counts), axis=0)
        x, y, z = np.where(inside, index, 0)
        return np.where(inside[:, None], self.mixtures[self.cells[z, y, x]], 0.0)


class VoxelMaps(NamedTuple):
    """All maps of a scene; argument of `phantomgen.ops.trace.voxels.add_map`.

    Parameters
    ----------
    numbers : which map a row of primitives is, else -1
    cells : voxels of all maps, one after the other
    starts, shapes : where each map begins, and its number of voxels (z, y, x)
    mixtures : volume fraction of each material in each mixture
    """

    numbers: Int64[np.ndarray, " row"]
    cells: Int32[np.ndarray, " voxel"]
    starts: Int64[np.ndarray, " map"]
    shapes: Int64[np.ndarray, "map 3"]
    mixtures: Float[np.ndarray, "mixture material"]

    @classmethod
    def of(cls, rows: Sequence[tuple[VoxelMap, tuple[int, ...]] | None]) -> "VoxelMaps | None":
        """Create the maps of all primitives.

        Parameters
        ----------
        rows : of each primitive, its map and the materials of the map's parts; None without a map

        Returns
        -------
        the maps; None where no primitive has one
        """
        maps = [row for row in rows if row is not None]
        if not maps:
            return None
        count = 1 + max(material for _, materials in maps for material in materials)
        tables, first, cells = [], 0, []
        for voxels, materials in maps:
            table = np.zeros((len(voxels.mixtures), count))
            for part, material in enumerate(materials):
                table[:, material] += voxels.mixtures[:, part]
            cells.append(voxels.cells.ravel() + np.int32(first))
            tables.append(table)
            first += len(table)
        has_map = np.array([row is not None for row in rows])
        return cls(
            numbers=np.where(has_map, np.cumsum(has_map) - 1, -1),
            cells=np.concatenate(cells),
            starts=np.cumsum([0, *(len(c) for c in cells[:-1])]),
            shapes=np.array([voxels.cells.shape for voxels, _ in maps]),
            mixtures=np.concatenate(tables),
        )

    def checked(self, rows: int, count: int) -> "VoxelMaps":
        """Check the arrays, and add columns for materials that no map has.

        Parameters
        ----------
        rows : number of primitives
        count : number of materials

        Returns
        -------
        the maps

        Raises
        ------
        InputError
            When the arrays would make a kernel read outside of them.
        """
        sizes = self.shapes.prod(axis=1)
        within = self.cells.min() >= 0 and self.cells.max() < len(self.mixtures)
        if self.numbers.shape != (rows,) or (self.starts + sizes).max() > len(self.cells) or not within:
            raise InputError(f"voxel maps do not match {rows} primitives, or hold voxels of no known mixture")
        if self.mixtures.shape[1] > count:
            raise InputError(f"voxel maps name material {self.mixtures.shape[1] - 1}, but there are {count}")
        padded = np.pad(self.mixtures, ((0, 0), (0, count - self.mixtures.shape[1])))
        return self._replace(mixtures=np.ascontiguousarray(padded, dtype=np.float64))
