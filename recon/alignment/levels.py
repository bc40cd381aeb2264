"""A scan at one resolution: blocks of pixels, voxels as large as these at the axis, and poses after a change."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float32

from phantomgen.geometry.panel_changes import smaller_panel
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from recon.alignment.log_projections import SummedCounts
from recon.alignment.panel_errors import Change, changed
from recon.voxel.projector_pair import ProjectorPair

# All chosen by hand.
COARSEST = 12  # columns of blocks at the coarsest level, about
FINEST = 40  # columns of blocks at the finest level, at most
MOST_VIEWS = 2  # views at a level, over its columns of blocks
MOST_VOXELS = 2_000_000  # voxels of a level; more make them larger
ATTENUATED = 0.1  # log projection at the border of the panel that shows an object beyond it
BEYOND = 1.5  # radius of the grid over that of the field of view, where the object extends beyond it


@dataclass(frozen=True, eq=False)
class Level:
    """A scan at one resolution.

    Parameters
    ----------
    full : counts of all pixels, of the views of this level
    factor : pixels along each side of a block
    """

    full: SummedCounts
    factor: int

    @classmethod
    def of(cls, counts: SummedCounts, factor: int) -> "Level":
        """Take as many views as a level needs, evenly spread.

        Parameters
        ----------
        counts : of all pixels and views
        factor : pixels along each side of a block

        Returns
        -------
        the level
        """
        views = len(counts.geometry)
        wanted = min(views, MOST_VIEWS * max(counts.geometry.panel.columns // factor, COARSEST))
        return cls(counts.some_views(np.arange(wanted) * views // wanted), factor)

    @cached_property
    def blocks(self) -> SummedCounts:
        """Counts in blocks of pixels."""
        return self.full.binned(self.factor)

    @cached_property
    def data(self) -> tuple[Float32[np.ndarray, "view row column"], Float32[np.ndarray, "view row column"]]:
        """Log projections and their weights."""
        return self.blocks.logs_and_weights()

    def geometry(self, change: Change) -> Geometry:
        """Compute the poses of the blocks after a change of the panel.

        Parameters
        ----------
        change : see `recon.alignment.panel_errors.changed`

        Returns
        -------
        the poses
        """
        moved, panel = changed(self.full.geometry, change), self.full.geometry.panel
        columns, rows = (
            slice(n % self.factor // 2, n % self.factor // 2 + n // self.factor * self.factor)
            for n in (panel.columns, panel.rows)
        )
        return smaller_panel(moved, columns, self.factor, rows)

    def pair(self, change: Change, phase: float = 0.0) -> ProjectorPair:
        """Create the projector after a change of the panel.

        Parameters
        ----------
        change : see `recon.alignment.panel_errors.changed`
        phase : shift of the voxels along all axes, in voxels

        Returns
        -------
        the projector
        """
        grid = self.grid
        shifted = replace(
            grid, origin=tuple(first - phase * size for first, size in zip(grid.origin, grid.spacing, strict=True))
        )
        return ProjectorPair(self.geometry(change), shifted)

    @cached_property
    def grid(self) -> Grid:
        """Voxels around all that the panel sees, and around the object beyond it."""
        radius, low, high, size = _field(self.blocks.geometry)
        logs, weights = self.data
        borders = np.concatenate([logs[:, :, 0][weights[:, :, 0] > 0], logs[:, :, -1][weights[:, :, -1] > 0]])
        if borders.size and np.quantile(borders, 0.9) > ATTENUATED:
            radius *= BEYOND
        size *= max((4 * radius**2 * (high - low) / size**3 / MOST_VOXELS) ** (1 / 3), 1.0)
        count, slices = (max(int(np.ceil(extent / size - 1e-6)), 1) for extent in (2 * radius, high - low))
        middle, half = (low + high) / 2, (count - 1) / 2 * size
        return Grid((slices, count, count), (size, size, size), (middle - (slices - 1) / 2 * size, -half, -half))


def factors(columns: int, rows: int, finest: int | None = None) -> list[int]:
    """Choose the blocks of the levels, from coarse to fine, each half as large as the one before.

    Parameters
    ----------
    columns, rows : of the panel
    finest : pixels along each side of the smallest blocks; chosen where left out

    Returns
    -------
    pixels along each side of a block, at each level
    """
    most = max(min(columns, 2 * rows) // 2, 1)
    last = min(finest or int(np.ceil(columns / FINEST)), most)
    found = [last]
    while columns / found[0] >= 2 * COARSEST and 2 * found[0] <= most:
        found.insert(0, 2 * found[0])
    return found


def _field(geometry: Geometry) -> tuple[float, float, float, float]:
    """Radius about the axis that is seen, lowest and highest z, and the size of a pixel at the axis [mm].

    The heights are those of the rays through the ends of the panel where they leave the field of view.
    """
    frames, panel = geometry.ray_frames(), geometry.panel
    radii, heights = [], []
    for row in (-0.5, panel.rows - 0.5):
        for column in (-0.5, panel.columns - 0.5):
            way = frames[:, 1] + column * frames[:, 2] + row * frames[:, 3]
            flat = np.einsum("vi,vi->v", way[:, :2], way[:, :2])
            near = -np.einsum("vi,vi->v", frames[:, 0, :2], way[:, :2]) / flat
            point = frames[:, 0] + near[:, None] * way
            radii.append(np.linalg.norm(point[:, :2], axis=1))
            beyond = near + radii[-1] / np.sqrt(flat)
            heights += [point[:, 2], (frames[:, 0] + beyond[:, None] * way)[:, 2]]
    middle = frames[:, 1] + (panel.columns - 1) / 2 * frames[:, 2] + (panel.rows - 1) / 2 * frames[:, 3]
    flat = np.einsum("vi,vi->v", middle[:, :2], middle[:, :2])
    at_axis = np.median(-np.einsum("vi,vi->v", frames[:, 0, :2], middle[:, :2]) / flat)
    pixel = panel.column_pitch * float(at_axis)
    return float(np.median(np.max(radii, axis=0))), float(np.min(heights)), float(np.max(heights)), pixel
